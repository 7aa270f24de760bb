"""`python -m thermojoint.cli.main`."""

from thermojoint.cli.main import main

if __name__ == "__main__":
    main()
