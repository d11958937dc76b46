"""The encoding of a text file: byte-order marks, UTF-8, UTF-16, and older encodings by words that occur in measured files.

The names of columns are the only text that matters, and they are short. Statistics of characters do not tell GBK, Shift-JIS and
Big5 apart in ten characters; the word for voltage or displacement does.
"""

from __future__ import annotations

import re

import numpy as np

from hystfit.errors import DataError
from hystfit.outcome import Code, Note
from hystfit.outcome.note import warn

_MAGIC = {
    b"PK\x03\x04": "a damaged zip archive or Excel file (copy it again, or save it again as .xlsx)",
    b"\x89HDF": "an HDF5 file (read it with hystfit.read)",
    b"\xd0\xcf\x11\xe0": "an old Excel file (read it with hystfit.read)",
    b"MATLAB": "a MATLAB file (read it with hystfit.read)",
    b"\x93NUMPY": "a numpy file (read it with hystfit.read)",
    b"TDSm": "a TDMS file (export it as CSV)",
    b"%PDF": "a PDF document (export the numbers as CSV)",
    b"\x89PNG": "a picture (export the numbers as CSV)",
    b"PAR1": "a Parquet file (read it with hystfit.read)",
    b"7z\xbc\xaf": "a 7-Zip archive (unpack it)",
    b"Rar!": "a RAR archive (unpack it)",
    b"CPYA": "an Origin project (export the worksheet as ASCII)",
    b"CPYUA": "an Origin project (export the worksheet as ASCII)",
    b"MDF  ": "an MDF file of CANape, INCA or others (export it as CSV)",
    b"SQLite format 3": "an SQLite database (export the table as CSV)",
    b"\x80\x04\x95": "a pickle of Python, which could run any program (save the arrays as .npz or CSV)",
    b"\x80\x05\x95": "a pickle of Python, which could run any program (save the arrays as .npz or CSV)",
    b"BIO-LOGIC": "a raw file of EC-Lab (export it as text, .mpt)",
    b"NEWARE": "a raw file of a Neware cycler (export it as CSV or Excel)",
    b"\x00\x01\x00\x00Standard Jet": "a database of Access, as Arbin cyclers write it (export the table as CSV)",
    b"ARROW1": "a Feather file (save it as Parquet or CSV)",
    b"version https://git-lfs": "a pointer of Git LFS (fetch the file itself with git lfs pull)",
}

# Words of column names and headers, by the encoding of files in that language.
_WORDS = {
    "gb18030": "时间 名称 单位 电压 电流 位移 力 载荷 荷载 应力 应变 磁场 磁矩 磁化 磁感应 电场 极化 电荷 温度 压力 频率 速度 位置 "
    "转角 输入 输出 试验 实验 测量 数据 样品 样本 通道 序号 编号 日期 质量 厚度 面积 滞回 循环 变形 扭矩 角度 长度",
    "cp932": "時間 名称 単位 電圧 電流 変位 力 荷重 応力 ひずみ 歪み 歪 磁場 磁化 磁束 電場 電界 分極 電荷 温度 圧力 周波数 速度 位置 "
    "角度 入力 出力 試験 実験 測定 データ 試料 番号 日付 質量 厚さ 面積 回数 変形 トルク チャンネル ﾃﾞｰﾀ 秒 長さ",
    "big5": "時間 名稱 單位 電壓 電流 位移 力 載荷 荷重 應力 應變 磁場 磁矩 磁化 電場 極化 電荷 溫度 壓力 頻率 速度 位置 角度 "
    "輸入 輸出 試驗 實驗 測量 量測 數據 資料 樣品 通道 編號 日期 質量 厚度 面積 變形 長度",
    "cp949": "시간 전압 전류 변위 하중 힘 응력 변형률 변형 자기장 자화 전기장 분극 온도 압력 주파수 속도 위치 입력 출력 시험 측정 "
    "데이터 번호",
    "cp1251": "время напряжение ток перемещение смещение сила нагрузка деформация поле намагниченность момент температура давление "
    "частота скорость положение вход выход испытание измерение данные образец номер дата ход",
    "cp1250": "siła napięcie prąd natężenie obciążenie odkształcenie naprężenie próbka próbki ciśnienie prędkość długość położenie "
    "čas napětí zatížení měření řízení vzorků průhyb idő erő hőmérséklet jegyzőkönyv",
    "cp1253": "χρόνος τάση ρεύμα μετατόπιση δύναμη θερμοκρασία πίεση συχνότητα ταχύτητα θέση είσοδος έξοδος",
    "cp1254": "yük ağırlık basınç sıcaklık hız giriş çıkış ölçüm yerdeğiştirme değiştirme süre açı şekil değer birim uzama gerilme gerçek",
}  # fmt: skip
_SAME_WORDS = {"euc_jp": "cp932", "koi8_r": "cp1251", "iso8859_5": "cp1251"}
# Characters that are common in text of one of the multi-byte encodings, by the first of their bytes there.
_COMMON = {"gb18030": range(0xB0, 0xD8), "cp932": (0x82, 0x83, *range(0x88, 0x98)), "big5": range(0xA4, 0xC7)}
_WESTERN = frozenset("µ°²³¹·±×÷½¼¾§¢£€¥©®«»¿¡ªº“”‘’‚„…–—•™‰´¨ØøÅåÆæœŒßÐðÞþŸ¬") | frozenset(
    "ÄäÖöÜüÉéÈèÊêËëÀàÁáÂâÃãÇçÌìÍíÎîÏïÒòÓóÔôÕõÙùÚúÛûÑñÝýÿŠšŽž"
)
_MOST = 20_000  # bytes of lines with other characters than ASCII that are examined


def encoding_of(raw: bytes, source: str) -> str:
    """Name of the encoding of a text file.

    Raises:
        DataError: the text is in an encoding of several bytes a character that cannot be told.
    """
    for mark, name in ((b"\xff\xfe\x00\x00", "utf-32"), (b"\x00\x00\xfe\xff", "utf-32")):
        if raw.startswith(mark):
            return name
    if raw.startswith((b"\xff\xfe", b"\xfe\xff")):
        return "utf-16"
    if wide := _utf16_without_mark(raw):
        return wide
    try:
        raw.decode("utf-8")
    except UnicodeDecodeError:
        return _legacy_encoding(raw, source)
    return "utf-8-sig" if raw.startswith(b"\xef\xbb\xbf") else "utf-8"


def _utf16_without_mark(raw: bytes) -> str:
    """UTF-16 without a byte-order mark: in rows of numbers every other byte is zero. "" for other text."""
    if b"\x00" not in raw:
        return ""
    padded = raw.rstrip(b"\x00")
    text = raw[: len(padded) + (len(padded) % 2 and len(raw) > len(padded))]
    for name, zeros, others in (("utf-16-le", text[1::2], text[0::2]), ("utf-16-be", text[0::2], text[1::2])):
        if len(text) > 3 and zeros.count(0) > 0.5 * len(zeros) and others.count(0) < 0.1 * len(others):
            try:
                text[: len(text) // 2 * 2].decode(name)
            except UnicodeDecodeError:
                continue
            return name
    return ""


def _legacy_encoding(raw: bytes, source: str) -> str:
    lines = [line for line in re.split(rb"[\r\n]+", raw) if not line.isascii()]
    sample = b"\n".join(lines)[:_MOST]
    shares = {name: _share_of_words(sample, name) for name in (*_WORDS, *_SAME_WORDS)}
    first, second = sorted(shares, key=lambda name: -shares[name])[:2]
    if shares[first] > 2 * shares[second]:
        return first
    if b"\n" not in raw:  # lines end as on a Macintosh of that time
        return "mac_roman"
    if _is_western(sample):
        return "cp1252"
    common = [name for name in _COMMON if _is_common(sample, name)]
    if common == ["cp932"] and not shares[first]:  # whose first bytes begin no common character of the others
        return "cp932"
    if shares[first] > 0 or common:
        names = [name for name in shares if shares[name] or name in common]
        raise DataError(
            f"{source}: the text is not UTF-8, and its encoding cannot be recognized ({' or '.join(names)}?): give it by "
            "--encoding (encoding=), such as gbk, shift_jis, big5, euc_kr or cp1252"
        )
    return "latin-1"


def _decoded(sample: bytes, name: str) -> str:
    """The sample in one encoding without a character cut off at its end; "" where it cannot be decoded."""
    for end in (None, -1, -2, -3) if len(sample) == _MOST else (None,):
        try:
            return sample[:end].decode(name)
        except UnicodeDecodeError:
            continue
    return ""


def _share_of_words(sample: bytes, name: str) -> float:
    """Share of the letters beyond ASCII that belong to known words, 0 where the sample is not in this encoding."""
    text = _decoded(sample, name).lower()
    letters = sum(not c.isascii() and c.isalpha() for c in text)
    covered = 0
    for word in _WORDS[_SAME_WORDS.get(name, name)].split():
        alone = r"(?<![^\W\d_]){}(?![^\W\d_])" if len(word) == 1 or word[0] < "\u2000" else "{}"
        covered += len(word) * len(re.findall(alone.format(re.escape(word)), text))
    return covered / letters if letters else 0.0


def _is_western(sample: bytes) -> bool:
    """Whether the sample is text in cp1252: single letters with accents within words, and symbols such as µ and °."""
    text = _decoded(sample, "cp1252")
    runs = re.findall(r"[^\x00-\x7f]+", text)
    symbols = re.compile(r"[µ°²³¹·±×÷–—“”‘’…]+|[^\W\d_][a-zß-ÿ]?")
    return bool(text) and _WESTERN.issuperset("".join(runs)) and all(symbols.fullmatch(run) for run in runs)


def _is_common(sample: bytes, name: str) -> bool:
    """Whether all characters of two bytes are common ones of this encoding, and there are several."""
    encoded = [c.encode(name) for c in re.findall(r"[^\x00-\x7f]", _decoded(sample, name))]
    wide = [c[0] for c in encoded if len(c) > 1]
    return len(wide) > 1 and {*wide} <= {*_COMMON[name]}


def _controls(plain: bytes) -> int:
    """Number of control bytes: those below a blank but for tab, line feed, vertical tab, form feed, carriage return and escape."""
    values = np.frombuffer(plain, np.uint8)
    breaks = values - np.uint8(9) <= 4  # 9 to 13: smaller values wrap around
    return int(np.count_nonzero(values < 32) - np.count_nonzero(breaks) - np.count_nonzero(values == 27))


def decode(raw: bytes, source: str, encoding: str | None) -> tuple[str, list[Note]]:
    """Text of a file and what was assumed about its encoding."""
    for magic, what in _MAGIC.items():
        if raw.startswith(magic):
            raise DataError(f"{source} is not text but {what}")
    notes: list[Note] = []
    if encoding is None:
        encoding = "utf-8" if raw.isascii() and b"\x00" not in raw else encoding_of(raw, source)
        if encoding == "latin-1":
            text = "the encoding of the text was not recognized, and latin-1 is assumed: set --encoding (encoding=)"
            notes.append(warn(Code.FILE_FORMAT, text))
        elif encoding not in ("utf-8", "utf-8-sig"):
            notes.append(Note(Code.FILE_FORMAT, f"encoding {encoding}, which was recognized from the text"))
    try:
        text = raw.decode(encoding).removeprefix("\ufeff")
    except LookupError as error:
        raise DataError(f"{source}: there is no encoding {encoding!r}; use utf-8, utf-16 or cp1252") from error
    except UnicodeError as error:
        raise DataError(
            f"{source} is not text in {encoding}: {error}; leave the encoding out or give another"
        ) from error
    ended = text.rstrip("\x00\x1a")  # the second marks the end of a file of DOS
    padded, nul = len(text) - len(ended), text.count("\x00", len(ended))
    text = ended
    if nul:
        notes.append(Note(Code.LEFT_OUT, f"{nul} NUL bytes at the end"))
    if encoding in ("utf-8", "utf-8-sig"):
        odd = _controls(raw) - padded
    else:
        odd = _controls(text.encode("utf-8", "surrogatepass"))
    if "\x00" in text or odd > max(2, 0.01 * len(text)):
        place = re.search(r"[\x00-\x08\x0e-\x1a\x1c-\x1f]", text)
        line = 1 + text.count("\n", 0, place.start() if place else 0)
        raise DataError(
            f"{source}, line {line}: {odd} NUL or control bytes; this is a binary or damaged file: export it as text, "
            "or as one of .mat, .npz, .xlsx, .h5"
        )
    if "\r" in text:
        text = text.replace("\r\r\n", "\n").replace("\r\n", "\n").replace("\r", "\n")
    return text, notes
