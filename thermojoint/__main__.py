"""`python -m thermojoint`."""

from thermojoint.cli.main import main

if __name__ == "__main__":
    main()
