"""The command ``slam``, which ``python -m slam`` is too: Ctrl-C is one line from the first moment on."""

import sys


def main() -> None:
    """Load the commands, which takes a moment, and run one."""
    try:
        from slam.cli import main as run

        run()
    except KeyboardInterrupt:
        print("slam: interrupted; nothing was written", file=sys.stderr)
        sys.exit(130)


if __name__ == "__main__":
    main()
