"""A few hundred spoilt files through the commands; `benchmarks/fuzz.py` tries ten thousand."""

import random

import pytest
from benchmarks.fuzz import KINDS, Fuzzer
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

CASES = settings(
    max_examples=50,
    deadline=None,
    derandomize=True,
    database=None,
    suppress_health_check=[HealthCheck.too_slow],
)


@pytest.fixture(scope="module")
def fuzzer(tmp_path_factory):
    return Fuzzer(tmp_path_factory.mktemp("fuzz"), 0)


@pytest.mark.parametrize("kind", KINDS)
def test_one_line_or_whole_files(monkeypatch, fuzzer, kind):
    monkeypatch.setenv("DMPTM_DEBUG", "1")  # an error of ours is raised, not reported

    @CASES
    @given(seed=st.integers(0, 2**64))
    def check(seed):
        fuzzer.rng = random.Random(seed)
        assert getattr(fuzzer, kind)() is None

    check()


@pytest.mark.long
@pytest.mark.parametrize("seed", range(6))
def test_whole_diagnoses(monkeypatch, fuzzer, seed):
    monkeypatch.setenv("DMPTM_DEBUG", "1")
    fuzzer.rng = random.Random(f"campaign {seed}")
    assert fuzzer.diagnose() is None


def test_an_error_of_ours_is_one_line_too(monkeypatch, capsys):
    from dmptm_ctrl import cli

    def broken(*_, **__):
        raise ZeroDivisionError("of\nours")

    monkeypatch.delenv("DMPTM_DEBUG", raising=False)
    monkeypatch.setattr(cli, "app", broken)
    assert cli.main(["log", "info", "x"]) == cli.OUR_FAULT
    out, err = capsys.readouterr()
    assert (out, err.count("\n")) == ("", 1)
    assert "ZeroDivisionError: of ours" in err
    monkeypatch.setenv("DMPTM_DEBUG", "1")
    with pytest.raises(ZeroDivisionError):
        cli.main(["log", "info", "x"])
