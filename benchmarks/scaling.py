"""How does the cost of simulation grow with time, batch size, bodies, samples kept and cores?

    python benchmarks/scaling.py

Prints a table and, as the last line, one JSON object: exponents of cost against time and batch
(1 is linear), the gain of a second core, peak memory of a batch of which only statistics are kept.
"""

import json
import time
import tracemalloc

import numpy as np

from dmptm_ctrl.simulate.batch import simulate_batch
from dmptm_ctrl.simulate.compiled import march, rest
from dmptm_ctrl.simulate.model import Model

DT = 1e-3  # s
REPEATS = 7
SECONDS = (1.0, 3.0, 10.0, 30.0, 100.0)
SIZES = (64, 128, 256, 512, 1024)
CORES = (1, 2)


def least(functions, clock=time.process_time):
    """Least seconds of functions that take turns, of the processor unless asked otherwise."""
    times = []
    for turn in range(REPEATS + 1):
        row = []
        for function in functions:
            start = clock()
            function()
            row.append(clock() - start)
        if turn:  # the first compiles
            times.append(row)
    return np.min(times, axis=0)


def voltages(seconds):
    times = DT * np.arange(round(seconds / DT) + 1)
    return times, np.tile(np.sin(np.pi * times), (2, 1))


def exponent(x, y):
    return round(float(np.polyfit(np.log(x), np.log(y), 1)[0]), 3)


def drives(count):
    return [Model().with_values(c=c) for c in np.linspace(1.0, 10.0, count)]


def run(model, seconds):
    _, u = voltages(seconds)
    x0 = rest(model, 0.0)
    return lambda: march(model, u, x0, DT)


def batch(count, seconds=1.0, jobs=1, **options):
    models = drives(count)
    times, u = voltages(seconds)
    return lambda: simulate_batch(models, times, u, jobs=jobs, **options)


def peak(function):
    """Peak of memory allocated in a call [MB]."""
    function()
    tracemalloc.start()
    function()
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return most / 1e6


def main():
    found = {}
    times = least([run(Model(), s) for s in SECONDS])
    found["time_exponent"] = exponent(SECONDS, times)
    for s, spent in zip(SECONDS, times, strict=True):
        print(f"{s:6.0f} s of motion      {1e3 * spent:10.3f} ms")
    times = least([batch(k) for k in SIZES])
    found["batch_exponent"] = exponent(SIZES, times)
    for k, spent in zip(SIZES, times, strict=True):
        print(f"{k:6d} drives for 1 s   {1e3 * spent:10.3f} ms")
    elastic = Model().with_effect("reducer_compliance", compliance=1e-4)
    three, five = least([run(Model(), 10.0), run(elastic, 10.0)])
    print(f"     3 bodies for 10 s   {1e3 * three:10.3f} ms")
    print(f"     5 bodies for 10 s   {1e3 * five:10.3f} ms")
    found["five_bodies_over_three"] = round(five / three, 2)
    times = least([batch(512, 3.0, jobs) for jobs in CORES], time.perf_counter)
    for jobs, spent in zip(CORES, times, strict=True):
        print(f"{jobs:6d} cores, 512 drives for 3 s {1e3 * spent:10.3f} ms")
    found["two_cores_over_one"] = round(times[0] / times[1], 2)
    for seconds in (1.0, 10.0):
        inputs = 2 * 8 * seconds / DT / 1e6
        few = peak(batch(64, seconds))
        kept = peak(batch(64, seconds, outputs=["omega_L"]))
        print(f"{seconds:6.0f} s, 64 drives: {few:.2f} MB with statistics only, {kept:.2f} MB kept")
        found[f"mb_statistics_{seconds:g}_s"] = round(few, 2)
        found[f"mb_inputs_{seconds:g}_s"] = round(inputs, 2)
        found[f"mb_kept_{seconds:g}_s"] = round(kept, 2)
    print(json.dumps(found))


if __name__ == "__main__":
    main()
