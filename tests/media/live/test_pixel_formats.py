"""Camera pixel formats, compared with a bitwise packing."""

import numpy as np
import pytest
from numpy.typing import NDArray

from heliograph.base.errors import MediaError
from heliograph.media.live.pixel_formats import pixel_format


def levels(rows: int, columns: int, bits: int) -> NDArray[np.uint16]:
    return np.random.default_rng(bits).integers(0, 1 << bits, (rows, columns)).astype(np.uint16)


def bit_stream(numbers: NDArray[np.uint16], bits: int) -> NDArray[np.uint8]:
    """PFNC "p": levels packed least significant bit first."""
    places = np.arange(bits)
    return np.packbits((numbers.reshape(-1, 1) >> places & 1).astype(np.uint8).ravel(), bitorder="little")


def pairs(numbers: NDArray[np.uint16], bits: int) -> NDArray[np.uint8]:
    """GigE Vision 1 "Packed": the upper bytes of two levels enclose a byte with both lower parts."""
    out: list[int] = []
    flat = [int(number) for number in numbers.ravel()] + [0] * (numbers.size % 2)
    low = bits - 8
    for one, other in zip(flat[::2], flat[1::2], strict=True):
        out += [one >> low, (one & (1 << low) - 1) | (other & (1 << low) - 1) << 4, other >> low]
    return np.array(out, np.uint8)


PACKED = {"p": bit_stream, "Packed": pairs}


@pytest.mark.parametrize("kind", ["Mono", "BayerRG", "BayerGR", "BayerGB", "BayerBG"])
@pytest.mark.parametrize("bits", [8, 10, 12, 14, 16])
def test_levels_in_whole_bytes(kind: str, bits: int) -> None:
    sent = levels(5, 7, bits)
    form = pixel_format(f"{kind}{bits}")
    data = sent.astype(np.uint8 if bits == 8 else "<u2").view(np.uint8).ravel()
    got = form.pixels(data, 7, 5, 0, "luma")
    assert (form.bits, got.dtype.name) == (bits, "uint8" if bits == 8 else "uint16")
    assert np.array_equal(got, sent)


@pytest.mark.parametrize("packing", PACKED)
@pytest.mark.parametrize("bits", [10, 12])
@pytest.mark.parametrize("columns", [8, 6, 7, 5])
def test_packed_levels(packing: str, bits: int, columns: int) -> None:
    sent = levels(3, columns, bits)
    got = pixel_format(f"Mono{bits}{packing}").pixels(PACKED[packing](sent, bits), columns, 3, 0, "luma")
    assert got.dtype == np.uint16
    assert np.array_equal(got, sent)


@pytest.mark.parametrize("packing", PACKED)
@pytest.mark.parametrize("columns", [8, 7])
def test_packed_rows_with_bytes_after_each(packing: str, columns: int) -> None:
    sent = levels(4, columns, 12)
    rows = [PACKED[packing](row, 12)[: -(-columns * 12 // 8)] for row in sent]
    data = np.concatenate([np.append(row, [99, 98]) for row in rows]).astype(np.uint8)
    assert np.array_equal(pixel_format(f"BayerRG12{packing}").pixels(data, columns, 4, 2, "luma"), sent)


def test_bytes_after_each_row_and_after_the_picture_are_left_out() -> None:
    sent = levels(4, 6, 8).astype(np.uint8)
    padded = np.pad(sent, ((0, 0), (0, 3)), constant_values=77).ravel()[:-3]
    for data, padding in ((padded, 3), (np.pad(sent.ravel(), (0, 9)), 0)):
        assert np.array_equal(pixel_format("Mono8").pixels(data, 6, 4, padding, "luma"), sent)


@pytest.mark.parametrize(("name", "order"), [
    ("RGB8", "rgb"), ("BGR8", "bgr"), ("RGBa8", "rgba"), ("BGRa8", "bgra"), ("RGB8Packed", "rgb"),
])  # fmt: skip
def test_colours(name: str, order: str) -> None:
    planes = {colour: levels(2, 3, 8).astype(np.uint8) // (place + 1) for place, colour in enumerate("rgba")}
    data = np.stack([planes[colour] for colour in order], axis=-1).ravel()
    luma = np.rint(0.299 * planes["r"] + 0.587 * planes["g"] + 0.114 * planes["b"])
    for channel, sent in {"red": planes["r"], "green": planes["g"], "blue": planes["b"], "luma": luma}.items():
        assert np.array_equal(pixel_format(name).pixels(data, 3, 2, 0, channel), sent)


@pytest.mark.parametrize(("name", "place"), [("YUV422_8", 0), ("YCbCr422_8", 0), ("YUV422_8_UYVY", 1)])
def test_luma_is_read_between_chroma(name: str, place: int) -> None:
    luma = levels(2, 4, 8).astype(np.uint8)
    data = np.full(16, 128, np.uint8)
    data[place::2] = luma.ravel()
    assert np.array_equal(pixel_format(name).pixels(data, 4, 2, 0, "luma"), luma)
    with pytest.raises(MediaError, match=rf"of {name} the luma is read: leave out --channel"):
        pixel_format(name).pixels(data, 4, 2, 0, "red")


@pytest.mark.parametrize("name", ["Mono1p", "Mono14p", "Mono8s", "Coord3D_ABC32f", "", "mono8"])
def test_other_pixels_and_too_few_bytes_are_refused(name: str) -> None:
    with pytest.raises(MediaError, match=r"are not read; set pixel_format to one of Mono8, Mono10"):
        pixel_format(name)
    with pytest.raises(MediaError, match="a picture of 4x4 pixels in Mono8 has 15 bytes, not 16"):
        pixel_format("Mono8").pixels(np.zeros(15, np.uint8), 4, 4, 0, "luma")
