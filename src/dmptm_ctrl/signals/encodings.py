"""Encodings of text files."""

import codecs
import re
from collections.abc import Collection

from dmptm_ctrl.signals.errors import NotALogError

_JAPANESE = re.compile(r"[\u3040-\u30ff\u4e00-\u9fff]")
# What signals are called where programs do not write Unicode; Russian without capitals.
_OLDER: dict[str, tuple[str, ...]] = {
    "gb18030": ("时间", "时刻", "速度", "转速", "位置", "角度", "转矩", "扭矩", "电压", "电流"),
    "big5": ("時間", "時刻", "速度", "轉速", "位置", "角度", "轉矩", "扭矩", "電壓", "電流"),
    "euc_kr": ("시간", "속도", "위치", "각도", "토크", "전압", "전류"),
    "euc_jp": ("時間", "時刻", "速度", "位置", "角度", "トルク", "電圧", "電流"),
    "cp1251": ("ремя", "корость", "оложение", "омент", "апряжение"),
    "koi8_r": ("ремя", "корость", "оложение", "омент", "апряжение"),
    "cp1250": (),
    "cp1253": (),
}


def encoding_of(head: bytes, source: str, wanted: Collection[str]) -> str:
    """Encoding of a text by its first bytes: UTF-8, -16, -32, else of an older program.

    `wanted` names, or usual ones, say which; Latin letters where none do, for ° and µ.
    NotALogError for what is no text.
    """
    if head[:64].count(0) < 8:  # a file that was to grow, and was not closed
        head = head.rstrip(b"\0")
    if head.startswith((b"\xff\xfe\0\0", b"\0\0\xfe\xff")):
        return "utf-32"
    if head.startswith((b"\xff\xfe", b"\xfe\xff")):
        return "utf-16"
    if b"\0" in head:
        half = len(head) // 4
        for encoding, zeros in (("utf-16-le", head[1::2]), ("utf-16-be", head[::2])):
            if zeros.count(0) > half:
                return encoding
        raise NotALogError(f"{source}: not a text file; save it as CSV in UTF-8")
    try:
        head[: max(len(head) - 3, 0) or None].decode("utf-8")
    except UnicodeDecodeError as error:
        if error.start < len(head) - 6:
            return _older(head, wanted)
    return "utf-8-sig"


def _older(head: bytes, wanted: Collection[str]) -> str:
    """Encoding of a text that is not in Unicode."""
    latin = head.decode("cp1252", "ignore")
    if names := [n for n in wanted if not n.isascii() and n not in latin]:
        texts = {encoding: head.decode(encoding, "ignore") for encoding in ("cp932", *_OLDER)}
        for encoding, text in texts.items():
            if all(name in text for name in names):
                return encoding
    if _is_japanese(head):
        return "cp932"
    usual = (e for e, words in _OLDER.items() if any(w.encode(e) in head for w in words))
    return next(usual, "cp1252")


def _is_japanese(head: bytes) -> bool:
    """Whether a text is in Shift-JIS: most of its letters begin with what is no Latin letter."""
    try:
        text = codecs.getincrementaldecoder("cp932")().decode(head)
    except UnicodeDecodeError:
        return False
    letters = len(_JAPANESE.findall(text))
    return letters > 1 and 2 * sum(0x81 <= byte <= 0x9F for byte in head) > letters
