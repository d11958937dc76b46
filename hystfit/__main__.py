"""`python -m hystfit`: the command line without its script."""

from hystfit.cli import main

if __name__ == "__main__":
    main()
