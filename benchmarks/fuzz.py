"""Does any log, rig.toml or model.toml bring the command to a traceback or a half-written file?

    python benchmarks/fuzz.py [--inputs 10000] [--campaigns 60] [--seed 0]

Good files are spoilt at random, in their bytes and in what they mean, and given to the commands.
Allowed are: done, with finite numbers in whole files; or exit code 2 with one line on standard
error and nothing written. Prints a table, and the inputs that broke something, if any.
"""

import argparse
import contextlib
import io
import math
import os
import random
import re
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import numpy as np
import pandas as pd

from dmptm_ctrl import data
from dmptm_ctrl.cli import main
from dmptm_ctrl.simulate.model import Model
from dmptm_ctrl.simulate.model_file import to_toml

ROWS = 300
NASTY = (
    *("", "0", "-1", "1e999", "-1e300", "1e-320", "nan", "inf", "9" * 5000, "'", '"', "\x00", "é"),
    *("[", "]" * 50, "{", "=", "\n", "\n\n", "#", "true", "[[x]]", "1979-05-27", '"""', "a.b.c"),
    *("[" * 3000, "\ufeff", "\r", ",", ";", "\t", "±", "unknown", "rigid", "9**9**9", "../x", "$("),
)


def bundled(rig, name, rows=ROWS):
    return pd.read_csv(data.path(rig) / f"{name}.csv.gz", nrows=rows)


def spoilt_text(text, rng):
    """Text with a few places cut, doubled, swapped or replaced."""
    for _ in range(rng.choice((1, 1, 1, 2, 5))):
        way = rng.randrange(6)
        lines = text.split("\n")
        k = rng.randrange(len(lines))
        if way == 0:  # a number becomes another
            found = list(re.finditer(r"-?\d+\.?\d*(?:e-?\d+)?", lines[k]))
            if found:
                m = rng.choice(found)
                new = rng.choice(
                    (*NASTY[:9], f"{float(m[0]) * 10 ** rng.uniform(-12, 12):.6g}", f"-{m[0]}")
                )
                lines[k] = lines[k][: m.start()] + new + lines[k][m.end() :]
            text = "\n".join(lines)
        elif way == 1:  # a line is lost or doubled
            lines[k : k + 1] = rng.choice(([], [lines[k]] * 2))
            text = "\n".join(lines)
        elif way == 2:  # two lines change places
            j = rng.randrange(len(lines))
            lines[k], lines[j] = lines[j], lines[k]
            text = "\n".join(lines)
        elif way == 3:  # the right side of an assignment is something else
            left, equals, _ = lines[k].partition("=")
            lines[k] = f"{left}{equals} {rng.choice(NASTY)}"
            text = "\n".join(lines)
        else:
            at = rng.randrange(len(text) + 1)
            text = text[:at] + rng.choice(NASTY) + text[at + rng.choice((0, 0, 1, 3, 30)) :]
    return text


def spoilt_frame(frame, rng):
    """Log whose columns mean something else."""
    frame = frame.copy()
    numbers = np.random.default_rng(rng.randrange(2**32))
    for _ in range(rng.choice((1, 1, 2, 3))):
        column = rng.choice(list(frame.columns))
        values = frame[column].to_numpy(float)
        n = values.size
        if n == 0:
            return frame
        k = rng.randrange(n)
        frame = rng.choice(
            (
                lambda f, c=column, v=values: f.assign(**{c: 0.0 * v}),
                lambda f, c=column, v=values: f.assign(**{c: v[0]}),
                lambda f, c=column, v=values: f.assign(**{c: -v}),
                lambda f, c=column, v=values: f.assign(**{c: v * 10.0 ** rng.uniform(-30, 30)}),
                lambda f, c=column, v=values: f.assign(**{c: np.clip(v, -0.3, 0.3)}),
                lambda f, c=column, v=values: f.assign(**{c: v[::-1]}),
                lambda f, c=column, v=values: f.assign(**{c: numbers.permutation(v)}),
                lambda f, c=column, v=values: f.assign(**{c: numbers.normal(size=v.size)}),
                lambda f, c=column, v=values, i=k: f.assign(
                    **{c: np.where(np.arange(v.size) == i, rng.choice((np.nan, np.inf, 1e12)), v)}
                ),
                lambda f, c=column: f.drop(columns=c) if len(f.columns) > 1 else f,
                lambda f, i=k: f.iloc[:i],
                lambda f, i=k: pd.concat([f.iloc[:i], f]),
                lambda f: f.iloc[::-1],
                lambda f, c=column: f.rename(columns={c: c.rpartition("_")[0] + "_mrad"}),
                lambda f, c=column: f[[c, *[o for o in f.columns if o != c]]],
            )
        )(frame)
    return frame


def complaint(arguments, made):
    """What is wrong with what a command did; None if all is well.

    `made` are the files that it should write, absent before.
    """
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            code = main([str(a) for a in arguments])
        except BaseException as error:
            return f"{type(error).__name__}: {error}"[:200]
    if code == 0:
        lost = [file.name for file in made if not file.exists()]
        return f"not written: {lost}" if lost else None
    if code != 2:
        return f"exit code {code}: {err.getvalue()[:200]}"
    if out.getvalue():
        return f"printed before it failed: {out.getvalue()[:200]!r}"
    line = err.getvalue()
    if not line.startswith("dmptm: ") or line.count("\n") != 1 or len(line) > 1000:
        return f"not one line: {line[:200]!r}"
    there = [file.name for file in made if file.exists()]
    return f"written although it failed: {there}" if there else None


class Fuzzer:
    """Spoils one kind of file after another in a folder of its own."""

    def __init__(self, folder, seed):
        self.folder, self.rng = folder, random.Random(seed)
        self.frames = [
            bundled("demo_rig", "open_sine_0v60"),
            bundled("null_rig", "open_multisine_preload"),
        ]
        axis = data.path("axis")
        self.rig_texts = [
            (axis / "rig.toml").read_text("utf-8"),
            data.PAPER_RIG.read_text("utf-8"),
            data.RIG_TEMPLATE.read_text("utf-8"),
        ]
        self.good_log = folder / "good.csv"
        self.frames[0].to_csv(self.good_log, index=False)
        self.good_model = folder / "good.toml"
        model = Model().with_effect("unbalance", cosine=3.0, sine=1.0)
        self.good_model.write_text(to_toml(model.with_effect("cogging", left_cosine=0.1)), "utf-8")
        self.axis_log = folder / "axis.csv"
        pd.read_csv(axis / "moves.csv.gz", nrows=ROWS).to_csv(self.axis_log, index=False)
        self.axis_model = folder / "axis_model.toml"
        self.axis_model.write_text(axis_model_text(axis), "utf-8")

    def spoilt_log(self):
        frame = self.rng.choice(self.frames)
        if self.rng.random() < 0.6:
            frame = spoilt_frame(frame, self.rng)
        text = frame.to_csv(index=False)
        return spoilt_text(text, self.rng) if self.rng.random() < 0.5 else text

    def put(self, name, text):
        path = self.folder / name
        path.write_bytes(text.encode("utf-8", "surrogatepass"))
        return path

    def log_info(self):
        return complaint(["log", "info", self.put("spoilt.csv", self.spoilt_log()), "--json"], [])

    def predict(self, log, model):
        out = self.folder / "pred.csv"
        out.unlink(missing_ok=True)
        before = sorted(self.folder.iterdir())
        wrong = complaint(["predict", log, "--model", model, "--out", out], [out])
        if wrong is None and out.exists():
            table = pd.read_csv(out)
            if not np.isfinite(table.to_numpy(float)).all():
                wrong = "a number in the prediction is not finite"
            out.unlink()
        if wrong is None and sorted(self.folder.iterdir()) != before:
            wrong = "files are left behind"
        return wrong

    def predict_log(self):
        return self.predict(self.put("spoilt.csv", self.spoilt_log()), self.good_model)

    def predict_model(self):
        text = spoilt_text(self.good_model.read_text("utf-8"), self.rng)
        return self.predict(self.good_log, self.put("spoilt.toml", text))

    def predict_chain_model(self):
        text = spoilt_text(self.axis_model.read_text("utf-8"), self.rng)
        return self.predict(self.axis_log, self.put("spoilt.toml", text))

    def rig_check(self):
        text = spoilt_text(self.rng.choice(self.rig_texts), self.rng)
        return complaint(["rig", "check", self.put("spoilt.toml", text)], [])

    def diagnose(self):
        """A whole diagnosis of two short logs, one or both spoilt."""
        logs = self.folder / "logs"
        logs.mkdir(exist_ok=True)
        out = self.folder / "out"
        chain = self.rng.random() < 0.5
        arguments = ["diagnose", logs, "--out", out, "--jobs", "1", "--quiet"]
        if chain:
            rig = (data.path("axis") / "rig.toml").read_text("utf-8")
            if self.rng.random() < 0.3:
                rig = spoilt_text(rig, self.rng)
            arguments += ["--rig", self.put("spoilt.toml", rig)]
            frames = [pd.read_csv(data.path("axis") / "moves.csv.gz", nrows=2500)]
        else:
            names = ("open_sine_0v60", "open_sine_0v75")
            frames = [bundled("demo_rig", name, 2500) for name in names]
        for k, frame in enumerate(frames):
            if k == 0 or self.rng.random() < 0.3:
                frame = spoilt_frame(frame, self.rng)
            frame.to_csv(logs / f"run_{k}.csv", index=False)
        made = [out / name for name in ("diagnosis.json", "model.toml", "report.html")]
        wrong = complaint(arguments, made)
        for folder in (out, logs):
            if folder.exists():
                for file in folder.iterdir():
                    file.unlink()
                folder.rmdir()
        return wrong


KINDS = ("log_info", "predict_log", "predict_model", "predict_chain_model", "rig_check")


def axis_model_text(axis):
    """Model file of the bundled linear axis, as declared."""
    from dmptm_ctrl.drive.rigfile import load_rig
    from dmptm_ctrl.simulate.model_file import rig_model_to_toml
    from dmptm_ctrl.simulate.rig_model import RigModel

    rig = load_rig(axis / "rig.toml")
    return rig_model_to_toml(RigModel(rig))


def run(inputs, campaigns, seed):
    """Return, per kind, how many inputs there were and what went wrong."""
    os.environ["DMPTM_DEBUG"] = "1"  # an error of ours is raised, not reported
    counts, wrongs = Counter(), []
    with tempfile.TemporaryDirectory() as folder:
        fuzzer = Fuzzer(Path(folder), seed)
        plan = [(kind, math.ceil(inputs / len(KINDS))) for kind in KINDS]
        for kind, count in [*plan, ("diagnose", campaigns)]:
            start = time.perf_counter()
            for k in range(count):
                state = f"{seed}:{kind}:{k}"
                fuzzer.rng = random.Random(state)
                wrong = getattr(fuzzer, kind)()
                counts[kind] += 1
                if wrong is not None:
                    wrongs.append((state, wrong))
            print(f"{kind:20} {count:6} inputs {time.perf_counter() - start:7.1f} s", flush=True)
    return counts, wrongs


def report(arguments=None):
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--inputs", type=int, default=10_000)
    parser.add_argument("--campaigns", type=int, default=60, help="whole diagnoses")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args(arguments)
    counts, wrongs = run(options.inputs, options.campaigns, options.seed)
    for state, wrong in wrongs[:40]:
        print(f"{state}: {wrong}")
    print(f"{sum(counts.values())} inputs, {len(wrongs)} broke something")
    return 1 if wrongs else 0


if __name__ == "__main__":
    sys.exit(report())
