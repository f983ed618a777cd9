"""Height maps in files: NumPy (.npy, .npz), grey PNG of 8 or 16 bits, ESRI ASCII grid (.asc)."""

from __future__ import annotations

import base64
import binascii
import zlib
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from engine.errors import BadInput, FormatError
from engine.world.relief import MAX_SIDE

F32 = NDArray[np.float32]
ENDINGS = (".npy", ".npz", ".png", ".asc")
_HEADER = ("ncols", "nrows", "xllcorner", "yllcorner", "xllcenter", "yllcenter", "cellsize", "nodata_value")


def read_heights(path: Path, *, low_m: float = 0.0, high_m: float = 1.0) -> tuple[F32, float | None]:
    """(H, W) heights in metres, row 0 at the bottom, and the side of a cell where the file says it. Raises FormatError.

    low_m, high_m: heights of black and white in a PNG. An .npz has `height_m`, or one array. In .npy and .npz row 0 is
    at the bottom; in pictures and .asc files the top row comes first. What an .asc file leaves out gets its least
    height.
    """
    readers = {".npy": _numpy, ".npz": _numpy, ".asc": _ascii_grid}
    ending = path.suffix.lower()
    if ending not in ENDINGS:
        raise FormatError(f"{path.name}: got a file ending in {ending!r}, expected {', '.join(ENDINGS)}")
    try:
        found, cell_m = _png(path, low_m, high_m) if ending == ".png" else readers[ending](path)
    except FileNotFoundError:
        raise FormatError(f"{path.name}: there is no such file") from None
    except OSError as why:
        raise FormatError(f"{path.name}: can't be read: {why.strerror or why}") from why
    if found.ndim != 2 or min(found.shape) < 3 or max(found.shape) > MAX_SIDE:
        size = " × ".join(map(str, found.shape))
        raise FormatError(f"{path.name}: got {size} heights, expected 3 × 3 to {MAX_SIDE} × {MAX_SIDE}")
    if not np.isfinite(found).all():
        raise FormatError(f"{path.name}: has heights that are no finite numbers")
    return found.astype(np.float32), cell_m


def _numpy(path: Path) -> tuple[NDArray[np.floating], None]:
    try:
        loaded = np.load(path, allow_pickle=False)
        if isinstance(loaded, np.ndarray):
            array = loaded
        else:
            with loaded:
                names = loaded.files
                name = "height_m" if "height_m" in names else names[0] if len(names) == 1 else ""
                if not name:
                    raise FormatError(f"{path.name}: got arrays {', '.join(names)}, expected one called 'height_m'")
                array = loaded[name]
    except (ValueError, EOFError, zlib.error) as why:
        if isinstance(why, FormatError):
            raise
        raise FormatError(f"{path.name}: not a NumPy file of numbers: {why}") from why
    if array.dtype.kind not in "iuf":
        raise FormatError(f"{path.name}: got an array of {array.dtype}, expected numbers")
    return array.astype(np.float64), None


def _png(path: Path, low_m: float, high_m: float) -> tuple[NDArray[np.floating], None]:
    from PIL import Image, UnidentifiedImageError

    try:
        with Image.open(path, formats=["PNG"]) as picture:
            if max(picture.size) > MAX_SIDE:
                raise FormatError(
                    f"{path.name}: got {picture.size[0]} × {picture.size[1]} pixels, at most {MAX_SIDE} a side"
                )
            if picture.mode not in ("L", "I", "I;16", "I;16B"):
                raise FormatError(f"{path.name}: got a picture of mode {picture.mode}, expected grey of 8 or 16 bits")
            white = 255 if picture.mode == "L" else 65535
            grey = np.asarray(picture).astype(np.float64)
    except (UnidentifiedImageError, SyntaxError) as why:
        raise FormatError(f"{path.name}: not a PNG picture") from why
    return grey[::-1] / white * (high_m - low_m) + low_m, None


def _ascii_grid(path: Path) -> tuple[NDArray[np.floating], float]:
    """ESRI ASCII grid: header lines `name number`, then rows of numbers from the top."""
    try:
        lines = path.read_text("ascii").splitlines()
    except UnicodeDecodeError:
        raise FormatError(f"{path.name}: ASCII text was expected") from None
    header: dict[str, float] = {}
    at = 0
    for at, line in enumerate(lines):
        words = line.split()
        if len(words) != 2 or words[0].lower() not in _HEADER:
            break
        try:
            header[words[0].lower()] = float(words[1])
        except ValueError:
            raise FormatError(f"{path.name}, line {at + 1}: got {words[1]!r}, expected a number") from None
    for name in ("ncols", "nrows", "cellsize"):
        if header.get(name, 0) <= 0:
            raise FormatError(f"{path.name}: the header has no positive {name}")
    columns, rows = int(header["ncols"]), int(header["nrows"])
    if columns > MAX_SIDE or rows > MAX_SIDE:
        raise FormatError(f"{path.name}: got {columns} × {rows} heights, expected at most {MAX_SIDE} a side")
    values: list[float] = []
    for number, line in enumerate(lines[at:], start=at + 1):
        try:
            values += map(float, line.split())
        except ValueError as why:
            raise FormatError(f"{path.name}, line {number}: {why}") from None
    if len(values) != rows * columns:
        raise FormatError(f"{path.name}: got {len(values)} heights, expected {rows} × {columns}")
    grid = np.array(values).reshape(rows, columns)[::-1]
    missing = grid == header.get("nodata_value", -9999.0)
    if missing.all():
        raise FormatError(f"{path.name}: has no heights at all")
    return np.where(missing, grid[~missing].min(), grid), header["cellsize"]


def packed(height_m: F32) -> str:
    """Heights as text that a scenario can hold: rows and columns, then whole millimetres, compressed, in base64."""
    mm = np.rint(height_m.astype(np.float64) * 1000)
    if np.abs(mm).max() > 2**31 - 1:
        raise BadInput("heights are beyond two thousand kilometres")
    rows, columns = height_m.shape
    steps = np.diff(mm.astype(np.int64), axis=1, prepend=0).astype("<i4")
    return f"{rows}x{columns}:{base64.b64encode(zlib.compress(steps.tobytes(), 9)).decode('ascii')}"


def unpacked(text: str) -> F32:
    """Undo `packed`. Raises BadInput."""
    size, _, data = text.partition(":")
    try:
        rows, columns = (int(word) for word in size.split("x"))
        if not (3 <= rows <= MAX_SIDE and 3 <= columns <= MAX_SIDE):
            raise ValueError(f"{rows} × {columns} heights")
        unpack = zlib.decompressobj()
        raw = unpack.decompress(base64.b64decode(data, validate=True), 4 * rows * columns)
        steps = np.frombuffer(raw, "<i4").reshape(rows, columns)
    except (ValueError, zlib.error, binascii.Error) as why:
        raise BadInput(f"heights are damaged: {why}; expected ROWSxCOLUMNS:DATA as a scenario's copy has it") from why
    return (np.cumsum(steps.astype(np.int64), axis=1) / 1000).astype(np.float32)
