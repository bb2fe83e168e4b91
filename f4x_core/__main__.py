"""`python -m f4x_core` is the same as `f4x`."""

import sys

from .cli import main

if __name__ == "__main__":
    sys.exit(main())
