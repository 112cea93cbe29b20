"""Makes the images of the reader's tests, one of every kind. Needs Pillow 13, OpenEXR 3.5 and NumPy 2 (`pip install pillow openexr numpy`).

Each shows four squares of 8 x 8 pixels: red, green, blue and grey; the blue one is half transparent where there is alpha."""

import os

import numpy
import OpenEXR
from PIL import Image

COLOURS = [(200, 40, 40), (40, 180, 60), (30, 60, 220), (128, 128, 128)]
ALPHA = [255, 255, 128, 255]
HERE = os.path.dirname(os.path.abspath(__file__))


def path(name):
    return os.path.join(HERE, name)


def squares():
    image = Image.new("RGBA", (16, 16))
    for i, (colour, alpha) in enumerate(zip(COLOURS, ALPHA)):
        image.paste(colour + (alpha,), (8 * (i % 2), 8 * (i // 2), 8 * (i % 2) + 8, 8 * (i // 2) + 8))
    return image


def floats():
    """Linear values: a hundredth of the byte, so that some are above 1 and all are halves nearly."""
    return numpy.asarray(squares().convert("RGB")).astype(numpy.float32) / 100


def write_exr(name, pixels, tiles):
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.tiledimage if tiles else OpenEXR.scanlineimage}
    if tiles:
        header["tiles"] = OpenEXR.TileDescription()
        header["tiles"].xSize = header["tiles"].ySize = 8
    channels = {c: numpy.ascontiguousarray(pixels[:, :, i]) for i, c in enumerate("RGB")}
    with OpenEXR.File(header, channels) as file:
        file.write(path(name))


def write_hdr(name, pixels):
    """Radiance RGBE without runs."""
    largest = pixels.max(axis=2)
    exponent = numpy.floor(numpy.log2(largest)).astype(int) + 1
    mantissas = numpy.floor(pixels * 256 / numpy.exp2(exponent)[:, :, None]).astype(numpy.uint8)
    rows = numpy.concatenate([mantissas, (exponent + 128).astype(numpy.uint8)[:, :, None]], axis=2)
    with open(path(name), "wb") as file:
        file.write(b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 16 +X 16\n" + rows.tobytes())


rgba = squares()
rgb = rgba.convert("RGB")
rgba.save(path("runs.tga"), compression="tga_rle")
rgb.save(path("plain.tga"))
rgb.save(path("progressive.jpg"), quality=95, progressive=True, subsampling=0)
rgb.convert("CMYK").save(path("cmyk.jpg"), quality=95)
rgb.convert("L").save(path("grey.jpg"), quality=95)
rgb.quantize(4).save(path("palette.png"))
rgba.save(path("alpha.png"))
rgba.convert("LA").save(path("grey-alpha.png"))
Image.fromarray((numpy.asarray(rgb.convert("L")).astype(numpy.uint16)) * 257).save(path("grey-16.png"))
rgb.convert("L").point(lambda v: 255 * (v > 100)).convert("1").save(path("bits.png"))
rgb.save(path("plain.bmp"))
rgb.quantize(4).save(path("palette.bmp"))
write_exr("half.exr", floats().astype(numpy.float16), False)
write_exr("tiles.exr", floats(), True)
write_hdr("plain.hdr", floats())
