"""``python -m dmptm_ctrl.data demo_rig`` prints the folder of the bundled logs."""

import sys

from dmptm_ctrl.data import path

if __name__ == "__main__":
    try:
        sys.stdout.write(f"{path(*sys.argv[1:2] or ['demo_rig'])}\n")
    except ValueError as error:
        sys.stderr.write(f"{error}\n")
        sys.exit(2)
