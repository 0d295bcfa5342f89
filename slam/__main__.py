"""The command ``slam``, also ``python -m slam``: Ctrl-C gives one line, even while modules are loaded."""

import sys


def main() -> None:
    """Load the commands and run one."""
    try:
        from slam.cli import main as run

        run()
    except KeyboardInterrupt:
        print("slam: interrupted; nothing was written", file=sys.stderr)
        sys.exit(130)


if __name__ == "__main__":
    main()
