"""``python -m celnav``."""

import sys

from celnav.cli import main

if __name__ == "__main__":
    sys.exit(main())
