import os
import signal
import stat
import subprocess
import sys
import time

import pytest

from dmptm_ctrl.signals.atomic import check_folder, output_folder, write_atomic


def test_writes_text_and_bytes(tmp_path):
    write_atomic(tmp_path / "a.txt", "Δ\n")
    assert (tmp_path / "a.txt").read_bytes() == "Δ\n".encode()
    write_atomic(tmp_path / "a.txt", b"\x00")
    assert (tmp_path / "a.txt").read_bytes() == b"\x00"
    assert os.listdir(tmp_path) == ["a.txt"]


def test_file_is_as_readable_as_any_other(tmp_path):
    write_atomic(tmp_path / "a", "x")
    (tmp_path / "b").write_text("x")
    assert stat.S_IMODE((tmp_path / "a").stat().st_mode) == stat.S_IMODE(
        (tmp_path / "b").stat().st_mode
    )


def test_failure_leaves_the_old_file(tmp_path, monkeypatch):
    write_atomic(tmp_path / "a", "old")
    monkeypatch.setattr(os, "fsync", lambda _: (_ for _ in ()).throw(OSError("disk full")))
    with pytest.raises(OSError, match="disk full"):
        write_atomic(tmp_path / "a", "new")
    assert (tmp_path / "a").read_text() == "old"
    assert os.listdir(tmp_path) == ["a"]


def test_folder_appears_at_the_end(tmp_path):
    with output_folder(tmp_path / "deep" / "out") as folder:
        (folder / "one").write_text("1")
        assert not (tmp_path / "deep" / "out").exists()
    assert (tmp_path / "deep" / "out" / "one").read_text() == "1"
    assert os.listdir(tmp_path / "deep") == ["out"]


def test_failure_leaves_nothing(tmp_path):
    with pytest.raises(KeyboardInterrupt), output_folder(tmp_path / "deep" / "out") as folder:
        (folder / "one").write_text("1")
        raise KeyboardInterrupt
    assert os.listdir(tmp_path) == []


def test_existing_folder_keeps_other_files(tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    (out / "mine").write_text("keep")
    (out / "one").write_text("old")
    (out / "sub").mkdir()
    (out / "sub" / "stale").write_text("old")
    with output_folder(out) as folder:
        (folder / "one").write_text("new")
        (folder / "sub").mkdir()
        (folder / "sub" / "fresh").write_text("new")
    assert (out / "mine").read_text() == "keep"
    assert (out / "one").read_text() == "new"
    assert os.listdir(out / "sub") == ["fresh"]
    with pytest.raises(RuntimeError), output_folder(out) as folder:
        (folder / "one").write_text("newer")
        raise RuntimeError
    assert (out / "one").read_text() == "new"
    assert os.listdir(tmp_path) == ["out"]


def test_a_file_in_the_way(tmp_path):
    (tmp_path / "out").write_text("x")
    with pytest.raises(NotADirectoryError), output_folder(tmp_path / "out"):
        pass
    assert (tmp_path / "out").read_text() == "x"


def test_a_file_in_the_way_is_seen_before_the_work(tmp_path):
    (tmp_path / "file").write_text("x")
    with pytest.raises(NotADirectoryError, match="in the place of the output folder"):
        check_folder(tmp_path / "file")
    with pytest.raises(NotADirectoryError, match="of file, above the output folder"):
        check_folder(tmp_path / "file" / "below" / "out")
    assert check_folder(tmp_path / "new" / "out") == (tmp_path / "new" / "out").resolve()
    assert not (tmp_path / "new").exists()


@pytest.mark.skipif(sys.platform == "win32", reason="no SIGKILL")
def test_a_kill_leaves_the_output_whole_or_absent(tmp_path):
    """Killed at ten moments while it writes, over and over, a file of one repeated letter."""
    program = (
        "import itertools, sys\n"
        "from dmptm_ctrl.signals.atomic import write_atomic\n"
        "print('ready', flush=True)\n"
        "for i in itertools.count():\n"
        "    write_atomic(sys.argv[1], 'abcdefghij'[i % 10] * 200_000)\n"
    )
    target = tmp_path / "out"
    for moment in range(10):
        with subprocess.Popen(
            [sys.executable, "-c", program, str(target)], stdout=subprocess.PIPE
        ) as process:
            process.stdout.readline()
            time.sleep(0.002 + 0.004 * moment)
            process.send_signal(signal.SIGKILL)
            process.wait()
        if target.exists():
            text = target.read_text()
            assert len(text) == 200_000
            assert len(set(text)) == 1
    assert target.exists()
