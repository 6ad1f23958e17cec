"""No small file takes gigabytes: each is refused in one line, within seconds and a bounded memory, under a limit of 1 GB.

A bomb of each format: lengths that are not there, contents that unpack to a thousand times their size, headers of images
that no file of that size can hold.
"""

import bz2
import os
import resource
import sqlite3
import struct
import subprocess
import time
import zlib

import lz4.frame
import pytest
import zstandard

LIMIT_BYTES = 1 << 30
MOST_RSS_BYTES = 256 << 20
# Seconds; a build for tests on a machine that does other things too.
LONGEST_S = 10.0

MAGIC = b"\x89MCAP0\r\n"


def record(opcode, body, length=None):
    return struct.pack("<BQ", opcode, len(body) if length is None else length) + body


def text(value, length=None):
    value = value.encode()
    return struct.pack("<I", len(value) if length is None else length) + value


def mcap(*records):
    return MAGIC + record(0x01, text("") + text("")) + b"".join(records)


def chunk(name, packed, size):
    return record(0x06, struct.pack("<QQQI", 0, 0, size, 0) + text(name) + struct.pack("<Q", len(packed)) + packed)


def zstd(pieces, level=19):
    """`pieces` of bytes as one zstd frame."""
    packer = zstandard.ZstdCompressor(level=level).compressobj()
    return b"".join([packer.compress(piece) for piece in pieces] + [packer.flush()])


def zeros(count, piece=1 << 22):
    """`count` zeros, a piece at a time."""
    for at in range(0, count, piece):
        yield bytes(min(piece, count - at))


SCHEMA = record(0x03, struct.pack("<H", 1) + text("foxglove.RawImage") + text("protobuf") + text(""))
CHANNEL = record(0x04, struct.pack("<HH", 1, 1) + text("/front/color") + text("protobuf") + text(""))


def message(data, length=None):
    return record(0x05, struct.pack("<HIQQ", 1, 0, 0, 0) + data, None if length is None else length + 22)


def long_message_in_chunk(size):
    head = message(b"", size)
    packed = zstd([head, *zeros(size)], 3)
    return mcap(SCHEMA, CHANNEL, chunk("zstd", packed, len(head) + size))


def tiny_records_in_chunk(count):
    piece = record(0x7F, b"") * 100_000
    packed = zstd(piece for _ in range(count // 100_000))
    return mcap(SCHEMA, CHANNEL, chunk("zstd", packed, 9 * count))


def tiny_messages_in_chunk(size):
    piece = message(b"") * 10_000
    count = size // len(piece)
    return mcap(CHANNEL, chunk("zstd", zstd(piece for _ in range(count)), count * len(piece)))


def png_chunk(name, body):
    return struct.pack(">I", len(body)) + name + body + struct.pack(">I", zlib.crc32(name + body))


def deflated(count):
    packer = zlib.compressobj(9)
    return b"".join([packer.compress(piece) for piece in zeros(count)] + [packer.flush()])


def png(width, height, bits, color, data=b"", extra=b"", interlaced=0):
    header = struct.pack(">IIBBBBB", width, height, bits, color, 0, 0, interlaced)
    return b"\x89PNG\r\n\x1a\n" + png_chunk(b"IHDR", header) + extra + png_chunk(b"IDAT", data) + png_chunk(b"IEND", b"")


def jpeg(width, height, components, progressive):
    sampling = b"".join(bytes([k + 1, 0x11, 0]) for k in range(components))
    frame = struct.pack(">BHHB", 8, height, width, components) + sampling
    table = b"\xff\xdb\x00\x43\x00" + bytes([1] * 64)
    huffman = b"\xff\xc4\x00\x14\x00\x01" + bytes(16)
    scan = bytes([components]) + b"".join(bytes([k + 1, 0]) for k in range(components)) + bytes([0, 0 if progressive else 63, 0])
    marker = b"\xff\xc2" if progressive else b"\xff\xc0"
    segments = marker + struct.pack(">H", len(frame) + 2) + frame + huffman + b"\xff\xda" + struct.pack(">H", len(scan) + 2) + scan
    return b"\xff\xd8" + table + segments + bytes(64) + b"\xff\xd9"


def tiff(width, height, strip, compression=1, strips=1, bits=8):
    tags = [(256, 4, 1, width), (257, 4, 1, height), (258, 3, 1, bits), (259, 3, 1, compression), (262, 3, 1, 1),
            (273, 4, strips, 8), (277, 3, 1, 1), (278, 4, 1, height), (279, 4, strips, len(strip))]
    directory = struct.pack("<H", len(tags)) + b"".join(struct.pack("<HHII", *tag) for tag in tags) + bytes(4)
    return b"II*\0" + struct.pack("<I", 8 + len(strip)) + strip + directory


def webp(chunk_name, body):
    body += bytes(len(body) % 2)
    return b"RIFF" + struct.pack("<I", 12 + len(body)) + b"WEBP" + chunk_name + struct.pack("<I", len(body)) + body


def bmp(width, height, bits, compression, data):
    header = struct.pack("<IiiHHIIiiII", 40, width, height, 1, bits, compression, 0, 0, 0, 0, 0)
    return b"BM" + struct.pack("<IHHI", 54 + 1024 + len(data), 0, 0, 54 + 1024) + header + bytes(1024) + data


def ros1_record(fields, data, length=None):
    head = b"".join(struct.pack("<I", len(name) + 1 + len(value)) + name + b"=" + value for name, value in fields.items())
    return struct.pack("<I", len(head)) + head + struct.pack("<I", len(data) if length is None else length) + data


def ros1(*records):
    return b"#ROSBAG V2.0\n" + ros1_record({b"op": b"\x03", b"index_pos": bytes(8)}, b"") + b"".join(records)


CONNECTION = ros1_record({b"op": b"\x07", b"conn": bytes(4), b"topic": b"/front/image_raw"},
                         struct.pack("<I", 22) + b"type=sensor_msgs/Image")


def ros1_chunk(compression, packed, size):
    return ros1_record({b"op": b"\x05", b"compression": compression, b"size": struct.pack("<I", size)}, packed)


def ros1_message(data, length=None):
    return ros1_record({b"op": b"\x02", b"conn": bytes(4), b"time": bytes(8)}, data, length)


def database(path, script, *messages):
    """A .db3 made by `script`, with `messages`; its bytes."""
    connection = sqlite3.connect(path)
    connection.executescript(script)
    for data in messages:
        connection.execute("INSERT INTO messages(topic_id, timestamp, data) VALUES (1, 0, ?)", [data])
    connection.commit()
    connection.close()
    return path.read_bytes()


TOPICS = "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT);" \
    "INSERT INTO topics VALUES (1, '/front/image_raw', 'sensor_msgs/msg/Image', 'cdr');"
MESSAGES = "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB);"
ENDLESS = "CREATE VIEW messages AS WITH RECURSIVE endless(n) AS (SELECT 1 UNION ALL SELECT n + 1 FROM endless) " \
    "SELECT n AS id, 1 AS topic_id, n AS timestamp, zeroblob(1000000000) AS data FROM endless;"
COMPUTED = "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, " \
    "data BLOB GENERATED ALWAYS AS (zeroblob(1000000000)) VIRTUAL); INSERT INTO messages VALUES (1, 1, 0);"


def cdr_image(length):
    """The beginning of a `sensor_msgs/msg/Image` whose data are `length` bytes that are not there."""
    fields = struct.pack("<II", 0, 0) + text("\0") + b"\0" * 3 + struct.pack("<II", 10_000, 10_000)
    return b"\0\x01\0\0" + fields + text("mono8\0") + b"\0" + b"\0" + struct.pack("<II", 10_000, length)


BOMBS = {
    "42_bytes.mcap": lambda path: MAGIC + record(0x0C, text("", 1) + b"x" + text("", 0xFFFFFFF0) + bytes(8)),
    "zstd_3_gb.mcap": lambda path: long_message_in_chunk(3_200_000_000),
    "zstd_200_mb.mcap": lambda path: long_message_in_chunk(200 << 20),
    "tiny_records.mcap": lambda path: tiny_records_in_chunk(300_000_000),
    "tiny_messages.mcap": lambda path: tiny_messages_in_chunk(400_000_000),
    "many_chunks.mcap": lambda path: mcap(SCHEMA, CHANNEL, *[chunk("zstd", zstd(zeros(40 << 20)), 40 << 20)] * 60),
    "lz4.mcap": lambda path: mcap(SCHEMA, CHANNEL, chunk("lz4", lz4.frame.compress(bytes(400 << 20)), 400 << 20)),
    "topic_4_gb.mcap": lambda path: mcap(record(0x04, struct.pack("<HH", 1, 0) + text("", 0xFFFFFFFF))),
    "statistics_4_gb.mcap": lambda path: mcap(record(0x0B, bytes(42) + struct.pack("<I", 0xFFFFFFFF))),
    "record_16_eb.mcap": lambda path: mcap(record(0x05, b"", 0xFFFFFFFFFFFFFFFF)),
    "raw_image.mcap": lambda path: mcap(SCHEMA, CHANNEL, message(b"\x18\x80\xb5\x18\x20\x80\xb5\x18")),
    "icc.png": lambda path: png(64, 64, 8, 0, deflated(65 * 64), png_chunk(b"iCCP", b"x\0\0" + deflated(3_100_000_000))),
    "text.png": lambda path: png(64, 64, 8, 0, deflated(65 * 64), png_chunk(b"zTXt", b"x\0\0" + deflated(1_000_000_000))),
    "gray_120_mp.png": lambda path: png(12_000, 10_000, 8, 0, deflated(12_001 * 10_000)),
    "rgba_16_bits.png": lambda path: png(5_000, 4_000, 16, 6, deflated(40_001 * 4_000)),
    "interlaced.png": lambda path: png(10_900, 10_900, 8, 2, deflated(1_000_000), interlaced=1),
    "one_bit.png": lambda path: png(60_000, 2_000, 1, 0, deflated(7_501 * 2_000)),
    "progressive.jpg": lambda path: jpeg(10_900, 10_900, 3, True),
    "four_components.jpg": lambda path: jpeg(65_500, 1_800, 4, True),
    "baseline.jpg": lambda path: jpeg(60_000, 2_000, 3, False),
    "deflate.tif": lambda path: tiff(12_000, 10_000, deflated(120_000_000), 8),
    "packbits.tif": lambda path: tiff(12_000, 10_000, b"\x81\0" * 1000, 32773),
    "four_billion_strips.tif": lambda path: tiff(100, 100, bytes(100), 1, 0xFFFFFFFF),
    "sixteen_bits.tif": lambda path: tiff(0x7FFFFFFF, 0x7FFFFFFF, bytes(100), 1, 1, 16),
    "canvas.webp": lambda path: webp(b"VP8X", struct.pack("<I", 0x10) + struct.pack("<I", 16_383)[:3] + struct.pack("<I", 16_383)[:3]),
    "lossless.webp": lambda path: webp(b"VP8L", b"\x2f" + struct.pack("<I", 16_382 | 7_000 << 14) + bytes(40)),
    "rle.bmp": lambda path: bmp(12_000, 10_000, 8, 1, b"\xff\0" * 4000),
    "empty.bmp": lambda path: bmp(30_000, 30_000, 24, 0, b""),
    "header.pgm": lambda path: b"P5 10900 10900 255\n" + bytes(100),
    "computed.db3": lambda path: database(path, TOPICS + COMPUTED),
    "endless.db3": lambda path: database(path, TOPICS + ENDLESS),
    "image_4_gb.db3": lambda path: database(path, TOPICS + MESSAGES, cdr_image(0xFFFFFFF0)),
    "packed_message.db3": lambda path: database(path, TOPICS + MESSAGES, zstd(zeros(1_000_000_000), 3)),
    "packed_file.db3.zstd": lambda path: zstd(zeros(1_000_000_000), 3),
    "bz2.bag": lambda path: ros1(CONNECTION, ros1_chunk(b"bz2", bz2.compress(bytes(300 << 20)), 300 << 20)),
    "lz4.bag": lambda path: ros1(CONNECTION, ros1_chunk(b"lz4", lz4.frame.compress(bytes(300 << 20)), 300 << 20)),
    "record_4_gb.bag": lambda path: ros1(CONNECTION, ros1_message(b"", 0xFFFFFFF0)),
    "deep.json": lambda path: b"[" * 3_000_000,
    "deep_views.json": lambda path: b'{"image_size":[640,480],"views":' + b'[{"object":' * 500_000,
    "views.json": lambda path: b'{"image_size":[640,480],"views":[' + b'{"object":[],"image":[]},' * 300_000 + b'{"object":[],"image":[]}]}',
    "deep.toml": lambda path: b"a = " + b"[" * 1_000_000,
}
# What is whole but for a chunk that nobody needs: it is read.
HARMLESS = {"icc.png", "text.png"}


def run(plumb_binary, arguments):
    """Exit code, stderr, seconds, and the most memory that it took, in bytes."""
    limit = lambda: resource.setrlimit(resource.RLIMIT_AS, (LIMIT_BYTES, LIMIT_BYTES))
    started = time.monotonic()
    process = subprocess.Popen([plumb_binary, *map(str, arguments)], stdout=subprocess.PIPE, stderr=subprocess.PIPE,
                               text=True, preexec_fn=limit)
    # Both are short: a line each.
    stdout, stderr = process.stdout.read(), process.stderr.read()
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    return process.returncode, stdout, stderr, time.monotonic() - started, usage.ru_maxrss << 10


@pytest.mark.parametrize("name", BOMBS)
def test_a_bomb_is_one_line(name, plumb_binary, tmp_path):
    path = tmp_path / name
    content = BOMBS[name](path)
    path.write_bytes(content)
    assert len(content) < 16_000_000
    by_ending = {"json": ["solve"], "toml": ["serve", "--config"]}
    arguments = [*by_ending.get(name.rpartition(".")[2], ["detect", "--board", "9x6", "--json"]), path]
    code, _, stderr, seconds, memory = run(plumb_binary, arguments)
    print(f"{name}: {len(content)} bytes, {seconds:.2f} s, {memory >> 20} MB: {stderr.strip()[:160]}")
    assert memory <= MOST_RSS_BYTES and seconds <= LONGEST_S
    if name in HARMLESS:
        assert (code, stderr) == (0, "")
    else:
        assert code in (1, 2), stderr
        lines = stderr.splitlines()
        assert len(lines) == 1 and name in lines[0] and len(lines[0]) < 600, stderr
