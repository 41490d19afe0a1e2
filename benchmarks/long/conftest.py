"""The rigs lie one folder up; what these tests share with those of CI lies in tests/."""

import sys
from pathlib import Path

HERE = Path(__file__).parents[1]
sys.path[:0] = [str(HERE), str(HERE.parent)]
