"""Small valid inputs to start fuzzing from: seeds.py ply|colmap FOLDER."""
import struct
import sys
from pathlib import Path

kind, folder = sys.argv[1], Path(sys.argv[2])


def ply(encoding: str, degree: int, count: int) -> bytes:
    rest = 3 * ((degree + 1) ** 2 - 1)
    names = ["x", "y", "z"] + [f"f_dc_{i}" for i in range(3)] + [f"f_rest_{i}" for i in range(rest)]
    names += ["opacity"] + [f"scale_{i}" for i in range(3)] + [f"rot_{i}" for i in range(4)]
    header = f"ply\nformat {encoding} 1.0\ncomment seed\nelement vertex {count}\n"
    header += "".join(f"property float {name}\n" for name in names) + "end_header\n"
    values = [0.25 * (i % 7) - 0.5 for i in range(len(names) * count)]
    if encoding == "ascii":
        width = len(names)
        rows = [" ".join(map(str, values[r * width : (r + 1) * width])) + "\n" for r in range(count)]
        return header.encode() + "".join(rows).encode()
    order = "<" if "little" in encoding else ">"
    return header.encode() + struct.pack(f"{order}{len(values)}f", *values)


def points() -> bytes:
    header = "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty double y\nproperty float z\n"
    header += "property uchar red\nproperty uchar green\nproperty uchar blue\n"
    header += "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
    return (header + "0 0 0 1 2 3\n1 1 1 4 5 6\n3 0 1 1\n").encode()


def colmap(text: bool) -> bytes:
    if text:
        cameras = b"# c\n1 PINHOLE 64 48 50 50 32 24\n"
        images = b"# i\n1 1 0 0 0 0 0 4 1 a.png\n1 2 -1\n2 0.5 0.5 0.5 0.5 0 0 4 1 b.png\n\n"
        points = b"# p\n1 0 0 0 10 20 30 0.5 1 0 2 0\n"
        rigs = b"# r\n1 3 CAMERA 1 CAMERA 2 1 1 0 0 0 0 0 0 IMU 1 0\n"
        frames = b"# f\n1 1 1 0 0 0 0 0 4 2 CAMERA 1 1 CAMERA 2 2\n"
    else:
        cameras = struct.pack("<QiiQQ4d", 1, 1, 1, 64, 48, 50, 50, 32, 24)
        image = struct.pack("<i7di", 1, 1, 0, 0, 0, 0, 0, 4, 1) + b"a.png\0"
        images = struct.pack("<Q", 1) + image + struct.pack("<Qddq", 1, 1.0, 2.0, -1)
        points = struct.pack("<QQ3d3BdQii", 1, 1, 0, 0, 0, 1, 2, 3, 0.5, 1, 1, 0)
        rigs = struct.pack("<Q2Iii", 1, 1, 3, 0, 1) + struct.pack("<iiB7d", 0, 2, 1, 1, 0, 0, 0, 0, 0, 0) + struct.pack("<iiB", 1, 1, 0)
        frames = struct.pack("<QII7dI", 1, 1, 1, 1, 0, 0, 0, 0, 0, 4, 1) + struct.pack("<iIQ", 0, 1, 1)
    lengths = struct.pack("<4H", len(cameras), len(images), len(rigs), len(frames))
    return bytes([int(text)]) + lengths + cameras + images + rigs + frames + points


if kind == "ply":
    encodings = ["ascii", "binary_little_endian", "binary_big_endian"]
    seeds = [ply(e, d, 2) for e in encodings for d in (0, 1)] + [points()]
else:
    seeds = [colmap(False), colmap(True)]
for number, seed in enumerate(seeds):
    (folder / f"seed{number}").write_bytes(seed)
