"""The report and the numbers behind its pictures, on a diagnosis whose truth is known."""

import os
import re
import subprocess
import sys
import tempfile
from dataclasses import replace
from functools import cache
from html import unescape
from html.parser import HTMLParser
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

import dmptm_ctrl
from dmptm_ctrl.diagnosis import html
from dmptm_ctrl.diagnosis.budget import Errors, Row, Squares, closed_rows, error_entry
from dmptm_ctrl.diagnosis.candidate import Candidate
from dmptm_ctrl.diagnosis.dual import key_of
from dmptm_ctrl.diagnosis.dual_report import DualSource, declared_dict, detectable, ranking
from dmptm_ctrl.diagnosis.html import render
from dmptm_ctrl.diagnosis.measure import measure
from dmptm_ctrl.diagnosis.predict import speed_error
from dmptm_ctrl.diagnosis.report import Diagnosis, NamedEffect, provenance
from dmptm_ctrl.diagnosis.select import Entry, Selection
from dmptm_ctrl.diagnosis.summary import with_amplitudes
from dmptm_ctrl.drive import paper_drive
from dmptm_ctrl.effects import CATALOGUE, TABLES
from dmptm_ctrl.identify.fit import Fit, drive_unknowns, effect_unknowns, position
from dmptm_ctrl.plots.diagnosis import plot_budget, plot_diagnosis, plot_evidence
from dmptm_ctrl.plots.gaps import animate_gaps, busiest, gap_motion
from dmptm_ctrl.plots.page import number, words
from dmptm_ctrl.signals import Log
from dmptm_ctrl.simulate.compiled import OUTPUTS, Loop, close_loop, march, rest
from dmptm_ctrl.simulate.linear import linearize
from dmptm_ctrl.simulate.model import Model
from dmptm_ctrl.simulate.model_file import model_text

COSINE, SINE = 6.0, -3.0  # N·m
DEG = np.pi / 180
DT = 1e-3
VOID = {"meta", "link", "img", "br", "hr", "input"}
SPITEFUL = "sine_15 <script>&\"'.csv"


def turn(model, name, speed, seconds=6.0):
    """Forth and back at one speed [deg/s] under a PI loop."""
    t = np.arange(0.0, seconds, DT)
    target = DEG * speed * np.where(t < seconds / 2, 1.0, -1.0)
    u, out = close_loop(model, Loop(0.08 / DEG, 0.4 / DEG, 10.0), target, DT, theta_L=-1.0)
    channels = {"u_left": u[0], "u_right": u[1], "theta_L": out[:, 0], "omega_L": out[:, 1]}
    return Log(name, t, channels, sha256="0" * 64)


def fitted(model, unknowns):
    p = position(model, unknowns)
    return Fit(model, unknowns, p, 1e-4 * np.eye(p.size))


def candidate(name, after):
    """A candidate beside the declared model, as the selection keeps it."""
    trial = SimpleNamespace(name=name, fit=after)
    return Candidate((key_of(name),), 30.0, 8.0, (trial,), "its gain would lie beyond all bounds")


def errors_of(before, after, logs):
    """The entry `error` of two models."""
    of = {"unit": "deg/s", "bandwidth_hz": 30.0}
    speed = {"before": speed_error(before, logs), "after": speed_error(after, logs)}
    speed["floor"] = {"rmse": 0.01}
    torque = {side: {"rmse": 0.3, "percent": 2.0, "unit": "N·m"} for side in speed}
    return error_entry("held-out logs", {k: {**v, **of} for k, v in speed.items()}, torque, None)


@cache
def made(verdict):
    drive = paper_drive().with_values(c=5.5, c_f=0.25)
    bare = Model(drive)
    full = bare.with_effect("unbalance", cosine=COSINE, sine=SINE)
    truth = bare if verdict == "none" else full
    logs = [turn(truth, "sine_10.csv", 10.0), turn(truth, SPITEFUL, 15.0)]
    measured = measure(logs, drive)
    before = fitted(bare, drive_unknowns(bare))
    after = before
    effects, entries, rows = (), [], []
    if verdict != "none":
        after = fitted(full, (*before.unknowns, *effect_unknowns("unbalance")))
        values = {"cosine": COSINE, "sine": SINE}
        effects = (
            NamedEffect(
                "unbalance",
                "ring gear",
                0.93,
                with_amplitudes(
                    {k: {"value": v, "se": 0.1, "unit": "N·m"} for k, v in values.items()}
                ),
                ("cable_spring",),
                "Adding it helps.",
                0.7,
            ),
        )
        entries = [Entry(key_of("unbalance"), 300.0, 200.0, (), None)]
        rows = [Row("unbalance", "ring gear", 0.4, 5.0, 1.0, ("theta_L",))]
    errors = {
        "none": Errors(1.1, 1.1, 1.0),
        "explained": Errors(10.0, 1.5, 1.0),
        "unknown": Errors(10.0, 5.0, 1.0),
    }[verdict]
    depends_on = ("theta_L",) if verdict == "unknown" else ()
    unknowns = (*before.unknowns, *effect_unknowns("cogging"))
    beside = candidate("cogging", fitted(bare.with_effect("cogging", order=6.0), unknowns))
    selection = Selection(None, None, entries, [beside], [beside])
    table = ranking(selection, ("mesh_error",), {}, ())
    held = [log for log in logs if log.name in {rec.name for rec in measured.held}]
    return Diagnosis(
        verdict=verdict,
        effects=effects,
        budget=tuple(closed_rows(rows, errors, (0.02, 0.3), (0.01, 0.1), depends_on)),
        ranking=table,
        depends_on=depends_on,
        error=errors_of(bare, after.model, held),
        errors=errors,
        declared=bare,
        augmented=after.model,
        declared_values=declared_dict(after, drive),
        selection=selection,
        source=DualSource(measured, selection, (before, after), after.model),
        provenance=provenance(logs, [log.name for log in held], 3, 1.5),
        warnings=("clipped <b>here</b>",),
    )


@pytest.fixture(scope="module", params=["explained", "none", "unknown"])
def diagnosis(request):
    return made(request.param)


@cache
def rendered(verdict):
    return render(made(verdict))


@pytest.fixture(scope="module")
def page(diagnosis):
    return rendered(diagnosis.verdict)


class Balanced(HTMLParser):
    """Collect ids, links, sources and text; complain where tags do not match."""

    def __init__(self):
        super().__init__()
        self.open, self.ids, self.links, self.sources, self.text = [], [], [], [], []
        self.headings, self.tags = [], set()

    def handle_starttag(self, tag, attrs):
        attrs = dict(attrs)
        self.tags.add(tag)
        self.ids += [attrs["id"]] if "id" in attrs else []
        self.links += [attrs["href"]] if "href" in attrs else []
        self.sources += [attrs["src"]] if "src" in attrs else []
        self.headings += [int(tag[1])] if re.fullmatch("h[1-6]", tag) else []
        if tag == "img":
            assert attrs["alt"]
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open and self.open[-1] != "style":
            self.text.append(data)


@pytest.fixture(scope="module")
def parsed(page):
    parser = Balanced()
    parser.feed(page)
    parser.close()
    return parser


def test_tags_match_and_links_work(parsed):
    assert parsed.open == []
    assert len(set(parsed.ids)) == len(parsed.ids)
    assert {"main", "header", "nav", "h1"} <= parsed.tags
    assert parsed.headings.count(1) == 1
    assert max(np.diff(parsed.headings)) <= 1  # no level left out
    assert {link[1:] for link in parsed.links} <= set(parsed.ids)


def test_self_contained(page, parsed):
    assert not re.search(r"https?://|//[a-z]|url\(|@import|file:", page.split("</style>")[0])
    assert all(
        source.startswith(("data:image/svg+xml;base64,", "data:image/gif;base64,"))
        for source in parsed.sources
    )
    assert all(link.startswith("#") for link in parsed.links)
    assert "script" not in parsed.tags
    shown = re.sub(r'src="data:[^"]*"', "", page)
    assert not re.search(r"(?<![\w<])/(home|root|tmp|usr|work)\b|\\\\|[A-Z]:\\", shown)


def test_no_place_of_this_machine_is_told(page):
    shown = re.sub(r'src="data:[^"]*"', "", page)
    for place in (
        Path.home(),
        Path.cwd(),
        Path(sys.executable).parent,
        Path(tempfile.gettempdir()),
    ):
        assert str(place) not in shown


def test_text_from_files_is_escaped(page):
    assert "sine_15 &lt;script&gt;&amp;" in page
    assert "clipped &lt;b&gt;here&lt;/b&gt;" in page


def test_every_effect_is_named_and_nothing_is_nan(diagnosis, parsed):
    text = " ".join(parsed.text)
    for name, effect in CATALOGUE.items():
        if name in TABLES:
            continue  # they have no name of their own
        assert name.replace("_", " ") in text
        assert effect.reveals in text
    assert not re.search(r"\b(nan|inf|None)\b", text)
    assert diagnosis.sentence() in text
    for name in diagnosis.source.measured.drive.free:
        assert name in text


def test_found_effects_stand_first_in_the_ranking_whatever_the_scores(diagnosis, page):
    statuses = [row["status"] for row in diagnosis.ranking]
    found = statuses.count("supported")
    assert "supported" not in statuses[found:]
    assert "A rejected effect may have a higher score" in page


def test_report_repeats_the_errors(diagnosis, parsed):
    for which in ("before", "after"):
        assert number(diagnosis.error[which]["rmse"]) in parsed.text


def test_the_budget_is_told_row_by_row(diagnosis, page, parsed):
    """In the table, with a dash where a row has no figure, and as a picture with words."""
    section = page.split('<h2 id="budget">')[1].split("</section>")[0]
    lines = re.findall(r"<tr><th scope=\"row\">.*?</tr>", section)
    cells = [re.findall(r">([^<]*)</t[hd]>", line) for line in lines]
    assert [row[0] for row in cells] == [words(row.name) for row in diagnosis.budget]
    assert [row[4] for row in cells] == [f"{100 * row.share:.1f}" for row in diagnosis.budget]
    assert sum(float(row[4]) for row in cells) == pytest.approx(100.0, abs=0.2)
    assert [row[2] for row in cells[-2:]] == ["0.02", "0.01"]
    assert cells[-2][5] == ", ".join(diagnosis.depends_on)
    assert 'alt="Error budget:' in page.split("<nav")[0]  # on the first screen


def test_a_run_that_is_no_worse_without_an_effect_is_said_in_the_budget():
    diagnosis = made("explained")
    first, *others = diagnosis.budget
    reported = replace(diagnosis, budget=(replace(first, speed_rms=0.0), *others))
    assert render(reported).count(">no rise<") == 1


def test_the_budget_is_drawn_as_it_is():
    """Bars as long as the shares, each with its name; the text stays inside the axes."""
    diagnosis = made("unknown")
    figure = Figure(figsize=(8.6, 2.0), layout="constrained")
    FigureCanvasAgg(figure)
    panel = plot_budget(diagnosis, ax=figure.subplots())
    figure.canvas.draw()
    bars = [bar.get_width() for bar in panel.patches]
    assert bars == pytest.approx([100.0 * row.share for row in diagnosis.budget])
    labels = [label.get_text() for label in panel.get_yticklabels()]
    assert labels == ["unbalance @ ring gear", "not explained", "floor"]
    whole, frame = figure.bbox, panel.get_window_extent()
    for label in panel.get_yticklabels():
        assert whole.containsx(label.get_window_extent().x0)
    for text in panel.texts:
        assert frame.containsx(text.get_window_extent().x1)
    assert "%" in panel.get_xlabel()


@pytest.fixture
def undrawn(monkeypatch):
    """A page without its pictures, which take seconds; words are what is looked at."""
    for figure in ("overlay_figure", "evidence_figure", "quality_figure"):
        monkeypatch.setattr(html, figure, lambda _: "")
    monkeypatch.setattr(DualSource, "pictures", lambda _: ())


def test_what_left_its_declared_range_is_on_the_first_screen(undrawn):
    diagnosis = made("none")
    values = {**diagnosis.declared_values}
    assert diagnosis.outside == ()
    values["J_L"] = {**values["J_L"], "outside": True}
    first = render(replace(diagnosis, declared_values=values)).split("<nav")[0]
    assert "At or outside the declared range: J_L." in first


def test_an_effect_that_hardly_matters_is_called_so(undrawn):
    diagnosis = made("explained")
    small = replace(diagnosis.effects[0], share=0.001)
    assert "immaterial" in render(replace(diagnosis, effects=(small,)))
    assert "immaterial" not in render(diagnosis)


def test_the_sentence_says_what_the_budget_says(diagnosis):
    reported = diagnosis.sentence()
    assert {
        "none": "the error of its balance is 1.05 times the floor",  # √(1.1/1)
        "explained": "lacks unbalance: 94 % of the removable error; free runs miss "
        "held-out logs by",  # (10 − 1.5)/(10 − 1)
        "unknown": "Found unbalance: 56 % of the removable error. The rest is "
        "unknown; it depends on theta_L",
    }[diagnosis.verdict] in reported
    assert "nothing is missing" not in diagnosis.summary()


def test_a_wave_has_its_amplitude():
    """Of a cosine C and a sine S it is √(C² + S²); errors add as squares, weighted by C and S."""
    diagnosis = made("explained")
    assert "\n  amplitude = 6.708 ± 0.1 N·m\n" in diagnosis.summary()  # √(6² + 3²)
    assert "ring gear (amplitude 6.71 N·m)" in html.action(diagnosis)
    left = {k: {"value": v, "se": 0.0, "unit": "rad"} for k, v in
            {"left_cosine": 3.0, "left_sine": 4.0, "order": 6.0}.items()}  # fmt: skip
    assert with_amplitudes(left)["left_amplitude"]["value"] == 5.0
    assert [*with_amplitudes(left)] == ["left_cosine", "left_sine", "order", "left_amplitude"]


@pytest.mark.parametrize(("times", "unknown"), [(1.4, False), (2.0, True)])
def test_what_free_runs_miss_beyond_their_floor_is_unknown(times, unknown):
    diagnosis = made("explained")
    runs = Squares(9.0, times**2, 1.0)
    reported = replace(diagnosis, errors=replace(diagnosis.errors, runs=runs)).sentence()
    assert ("The rest is unknown; free runs miss" in reported) == unknown
    assert (f"{times} times their floor" in reported) == unknown


def test_runs_that_miss_more_than_the_declared_model_are_said_to():
    diagnosis = made("explained")
    worse = {**diagnosis.error["after"], "rmse": 3.0 * diagnosis.error["before"]["rmse"]}
    reported = replace(diagnosis, error={**diagnosis.error, "after": worse}).sentence()
    assert f"those of the declared model by {diagnosis.error['before']['rmse']:.3g}" in reported
    assert "those of the declared model" not in diagnosis.sentence()


def test_no_doubtful_name_stands_in_the_sentence():
    """A name below probability 0.5 is counted, not said; a sure one beside it is said."""
    diagnosis = made("explained")
    sure = diagnosis.effects[0]
    doubtful = replace(sure, name="cogging", probability=0.4)
    reported = replace(diagnosis, effects=(sure, doubtful)).sentence()
    assert "lacks unbalance, 1 effect of uncertain name: 94 %" in reported
    assert "cogging" not in reported
    assert "cable spring" not in reported  # a rival of the sure one
    alone = replace(diagnosis, effects=(doubtful, doubtful)).sentence()
    assert "lacks 2 effects of uncertain name" in alone


def test_sizes_beyond_all_bounds_are_not_called_detectable():
    """Three standard errors are a size only where the effect can be as large."""
    unknowns = effect_unknowns("cogging")
    model = Model().with_effect("cogging", order=6.0)
    p = position(model, unknowns)
    for variance, shown in ((1e-4, True), (1e12, False)):
        beside = candidate("cogging", Fit(model, unknowns, p, variance * np.eye(p.size)))
        assert bool(detectable(beside)) is shown


def test_same_bytes_every_time():
    assert render(made("explained")) == rendered("explained")


def test_the_code_reads_the_model(tmp_path):
    """Another process runs it beside model.toml and gets the same numbers, plant and motion."""
    diagnosis = made("explained")
    shown = re.search(r"<code>(import numpy.*?)</code>", rendered("explained"), re.S)
    (tmp_path / "read.py").write_text(unescape(shown[1]), encoding="utf-8")
    (tmp_path / "model.toml").write_text(model_text(diagnosis.augmented), encoding="utf-8")
    program = (
        "import runpy, numpy as np\n"
        "made = runpy.run_path('read.py')\n"
        "plant = made['model'].plant()\n"
        "np.savez('made.npz', law=plant.law, link_values=plant.link_values, on=plant.on,\n"
        "         values=plant.values, inputs=made['plant'].ninputs,\n"
        "         poles=made['linear'].poles(), outputs=made['response'].outputs)\n"
    )
    source = str(Path(dmptm_ctrl.__file__).parents[1])
    environment = {**os.environ, "PYTHONPATH": source}
    subprocess.run([sys.executable, "-c", program], cwd=tmp_path, check=True, env=environment)
    found = np.load(tmp_path / "made.npz")
    for name in ("law", "link_values", "on", "values"):
        np.testing.assert_array_equal(found[name], getattr(diagnosis.augmented.plant(), name))
    u = np.full((2, found["outputs"].shape[1]), 0.6)
    model = diagnosis.augmented
    compiled = march(model, u, rest(model, 0.0), 1e-3)
    speed = list(OUTPUTS).index("omega_L")
    assert found["outputs"][speed, -1] == pytest.approx(compiled[-1, speed], rel=0.02)
    np.testing.assert_array_equal(found["poles"], linearize(model).poles())


def test_gaps_are_in_contact_where_the_motor_pushes():
    """Before the reversal the pinions push forward, after it backward."""
    diagnosis = made("explained")
    motion = gap_motion(diagnosis.source.measured.logs[0], diagnosis.augmented)
    for side in (0, 1):
        assert motion.contact[side, 2500] == 1
        assert motion.contact[side, 5500] == -1
    part = busiest(motion, 1.0)
    assert part.time[0] < 3.0 < part.time[-1] or part.time[0] < 0.5
    assert set(np.unique(part.contact)) == {-1, 0, 1} or part.time[0] < 0.5
    pages = animate_gaps(part, frames=2).to_jshtml(default_mode="once")
    assert pages.count("data:image/png") == 2


def test_overlay_agrees_with_the_verdicts_error(diagnosis):
    (overlay,) = diagnosis.overlays()
    for which in ("before", "after"):
        wanted = diagnosis.error[which]
        assert overlay.rmse(which) == pytest.approx(wanted["rmse"], rel=1e-9, abs=1e-12)
        assert overlay.fit_percent(which) == pytest.approx(wanted["fit_percent"], rel=1e-9)


def test_short_predictions_of_the_true_model_miss_nothing_but_transients():
    """Kept near its own angle, the true model follows its own speed."""
    (overlay,) = made("explained").overlays()
    left = overlay.measured - overlay.ahead
    assert np.nanmedian(np.abs(left)) < 0.02 * np.std(overlay.measured)


def test_evidence_is_the_torque_that_is_missing():
    """The observer's torque against the closed form of the effect."""
    evidence = made("explained").evidence()
    assert set(evidence.before) == set(evidence.after) == {"forward", "backward"}
    for curve in evidence.before.values():
        angle = DEG * curve.x
        wanted = COSINE * np.cos(angle) + SINE * np.sin(angle)
        # the bins of start and reversal hold transients, and say so by their errors
        assert (np.abs(curve.mean - wanted) < 0.15 + 4.0 * curve.se).all()
        assert np.median(curve.se) < 0.03
    for curve in evidence.after.values():
        np.testing.assert_allclose(curve.mean, 0.0, atol=0.2)


@pytest.mark.parametrize("name", CATALOGUE)
def test_every_effect_has_evidence_to_draw(name):
    """Whatever wins, there is a variable, a label with its unit, and curves."""
    diagnosis = made("explained")
    effect = replace(diagnosis.effects[0], name=name)
    evidence = replace(diagnosis, effects=(effect,)).evidence()
    assert evidence.effect == name
    assert re.search(r"\[.+\]$", evidence.variable)
    assert re.search(r"\[.+\]$", evidence.quantity)
    assert evidence.before


def test_plots_use_the_axes_given():
    diagnosis = made("explained")
    panels = Figure().subplots(2, 1)
    drawn = plot_diagnosis(diagnosis, ax=panels)
    assert list(drawn.ravel()) == list(panels)
    labels = [line.get_label() for line in panels[0].get_lines()]
    assert labels[0] == "measured"
    assert all(re.fullmatch(r".*RMSE \S+ deg/s, FIT \S+ %", label) for label in labels[1:])
    assert "[deg/s]" in panels[1].get_ylabel()
    figure = panels[0].figure
    FigureCanvasAgg(figure)
    figure.canvas.draw()
    legend = panels[0].get_legend().get_window_extent()
    assert legend.y0 >= panels[0].get_window_extent().y1 - 1.0  # off the curves
    pair = Figure().subplots(1, 2)
    assert list(plot_evidence(diagnosis, ax=pair)) == list(pair)
    with pytest.raises(ValueError, match="axes given"):
        plot_evidence(diagnosis, ax=pair[0])


def test_what_effects_explain_together_is_said_by_their_names():
    """Each alone is small beside what two share; two of one name have their places."""
    found = made("explained")
    each = replace(found.effects[0], name="coulomb_friction", share=0.01)
    two = (replace(each, location="motor"), replace(each, location="table"))
    said = replace(found, effects=two).sentence()
    assert "lacks coulomb friction of motor, coulomb friction of table" in said
