"""Nowhere to keep compiled code: not in the package, not in a home, not where numba looks."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import dmptm_ctrl

PROGRAM = """
import sys
import numpy as np
from dmptm_ctrl.cli import main
from dmptm_ctrl.identify.ripple import waves
from dmptm_ctrl.simulate.loading import cache_folder

code = main(["log", "info", sys.argv[1]])
found = waves(np.zeros(3), np.ones(3), 2)  # a compiled call
with open(cache_folder() / "probe", "x"):
    pass
print("code", code, "sums", (found == 3.0).all())
"""


def test_is_no_error(tmp_path):
    package = Path(dmptm_ctrl.__file__).parent
    no_cache = shutil.ignore_patterns("__pycache__")
    shutil.copytree(package, tmp_path / "dmptm_ctrl", ignore=no_cache)
    for folder in [tmp_path, *tmp_path.rglob("*")]:
        if folder.is_dir():
            (folder / "__pycache__").touch()  # a file in its place: refused, also to root
    file = tmp_path / "a_file"
    file.touch()
    places = ("HOME", "XDG_CACHE_HOME", "NUMBA_CACHE_DIR", "DMPTM_CACHE_DIR")
    environment = {**os.environ, **dict.fromkeys(places, str(file)), "PYTHONPATH": str(tmp_path)}
    log = tmp_path / "dmptm_ctrl" / "data" / "demo_rig" / "open_sine_0v60.csv.gz"
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM, str(log)],
        env=environment, cwd=tmp_path, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert done.stdout.rstrip().endswith("code 0 sums True")
    assert "Traceback" not in done.stderr
