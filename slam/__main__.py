"""``python -m slam``: the command ``slam``, where its script is not on the path."""

from slam.cli import main

if __name__ == "__main__":
    main()
