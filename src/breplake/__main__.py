"""``python -m breplake`` is the command ``breplake``."""

from breplake.cli import main

if __name__ == "__main__":
    main()
