"""``python -m dmptm_ctrl`` is ``dmptm``."""

import sys

from dmptm_ctrl.cli import main

if __name__ == "__main__":
    sys.exit(main())
