"""`python -m tianim` is the `tianim` command."""

from tianim.cli import main

if __name__ == "__main__":
    main()
