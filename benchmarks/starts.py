"""How long does a fresh process take to its first result, as an installed package has it?

    python benchmarks/starts.py

Prints one JSON object: seconds, and seconds of the processor, from the first line on. The numbers
of a result are there before python-control is; who asks for its TimeResponseData waits for that.
"""

import json
import os
import subprocess
import sys
import tempfile

import numpy as np

IMPORT = "import dmptm_ctrl"
FIRST = """
import numpy as np
from dmptm_ctrl.simulate import simulate
from dmptm_ctrl.simulate.model import Model
response = simulate(Model(), 1e-3 * np.arange(1000), np.ones((2, 1000)))
assert response.outputs.shape == (8, 1000)
"""
WHOLE = f"{FIRST}assert response.output_labels[0] == 'theta_L'\n"  # of python-control
ARRAYS = """
import numpy as np
from dmptm_ctrl.simulate.compiled import march, rest
from dmptm_ctrl.simulate.model import Model
march(Model(), np.ones((2, 1000)), rest(Model(), 0.0), 1e-3)
"""
STARTS = {  # what a fresh process does; the first without anything compiled
    "cold_simulate": FIRST,
    "warm_simulate": FIRST,
    "warm_time_response_data": WHOLE,
    "warm_python_control_alone": "import control",
    "warm_march": ARRAYS,
    "warm_import": IMPORT,
}


def starts(folder, repeats=3):
    """Seconds from a fresh process's first line to a result, as an installed package has them."""
    kept = {"DMPTM_CACHE_DIR": folder, "NUMBA_CACHE_DIR": folder}
    mine = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"} | kept
    found = {}
    for name, text in STARTS.items():
        code = (
            f"import time; start = time.perf_counter(), time.process_time()\n{text}\n"
            "print(time.perf_counter() - start[0], time.process_time() - start[1])"
        )
        times = [
            [
                float(x)
                for x in subprocess.run(
                    [sys.executable, "-c", code], env=mine, check=True, capture_output=True
                ).stdout.split()
            ]
            for _ in range(1 if name.startswith("cold") else repeats + 1)
        ]
        wall, processor = np.min(times, axis=0)
        found[name] = {
            "seconds": round(float(wall), 2),
            "of_the_processor": round(float(processor), 2),
        }
    return found


def main():
    with tempfile.TemporaryDirectory() as folder:
        print(json.dumps(starts(folder)))


if __name__ == "__main__":
    main()
