"""Outputs that are there whole or not at all, whenever the program is stopped."""

import os
import secrets
import shutil
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from os import PathLike
from pathlib import Path


def write_atomic(path: str | PathLike[str], content: str | bytes | Iterable[str]) -> None:
    r"""Write a file beside its place, then rename it there; on OSError the old one is still there.

    Text is written as UTF-8 with ``\n`` line ends, an iterable part by part.
    """
    target = Path(path).resolve()
    parts: Iterable[str | bytes] = [content] if isinstance(content, str | bytes) else content
    beside = _beside(target)
    try:
        with beside.open("xb") as stream:
            for part in parts:
                stream.write(part.encode() if isinstance(part, str) else part)
            stream.flush()
            os.fsync(stream.fileno())
        beside.replace(target)
    except BaseException:
        beside.unlink(missing_ok=True)
        raise


def check_folder(path: str | PathLike[str]) -> Path:
    """Return where a folder of results would be; OSError if a file is in the way."""
    target = Path(path).resolve()
    for place in (target, *target.parents):
        if place.exists() and not place.is_dir():
            what = "of" if place == target else f"of {place.name}, above"
            raise NotADirectoryError(
                20, f"a file is in the place {what} the output folder", str(path)
            )
    return target


@contextmanager
def output_folder(path: str | PathLike[str]) -> Iterator[Path]:
    """Yield an empty folder to write several outputs to; they appear in ``path`` together.

    A new folder appears by one rename, with its parents. In a folder that exists, files of the
    same names are removed before the new ones move in one by one, so that old and new never
    mix; other files stay. Nothing appears, and no folder is left behind, if the body raises.
    """
    target = check_folder(path)
    made = [parent for parent in target.parents if not parent.exists()]
    beside = _beside(target)
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        beside.mkdir()
        yield beside
        _move_in(beside, target)
    except BaseException:
        shutil.rmtree(beside, ignore_errors=True)
        for parent in made:
            with suppress(OSError):  # someone else has put something there
                parent.rmdir()
        raise


def _move_in(beside: Path, target: Path) -> None:
    if not target.exists() or not any(target.iterdir()):
        with suppress(FileNotFoundError):
            target.rmdir()
        beside.rename(target)
        return
    names = sorted(entry.name for entry in beside.iterdir())
    for name in names:
        old = target / name
        if old.is_dir() and not old.is_symlink():
            shutil.rmtree(old)
        else:
            old.unlink(missing_ok=True)
    for name in names:
        (beside / name).rename(target / name)
    beside.rmdir()


def _beside(target: Path) -> Path:
    """Hidden name in the same folder, hence on the same disk, that nobody else uses."""
    return target.with_name(f".{target.name[:100]}.{os.getpid()}.{secrets.token_hex(4)}")
