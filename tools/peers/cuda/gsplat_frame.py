"""A frame by gsplat, forward, and forward with backward: gsplat_frame.py SCENE.ply CAMERAS.json WIDTH HEIGHT [PICTURE.png]

Takes torch with CUDA and gsplat. Beside it, with the same scene and camera:
  ashsplat bench render --no-read-back --scene SCENE.ply --camera CAMERAS.json --width WIDTH --height HEIGHT
  ashsplat bench train-step --scene SCENE.ply --camera CAMERAS.json --width WIDTH --height HEIGHT
"""

import json
import sys

import numpy as np
import torch
from gsplat import rasterization

WARM_UP, MEASURED = 10, 40


def read_ply(path):
    """Names of the properties, and their values per Gaussian."""
    with open(path, "rb") as file:
        names, count = [], 0
        for line in iter(lambda: file.readline().decode().split(), ["end_header"]):
            if line[:2] == ["element", "vertex"]:
                count = int(line[2])
            elif line[0] == "property":
                names.append(line[-1])
        values = np.fromfile(file, np.float32, count * len(names)).reshape(count, len(names))
    return names, values


def scene(path):
    names, values = read_ply(path)

    def columns(*wanted):
        return torch.tensor(values[:, [names.index(name) for name in wanted]], device="cuda")

    rest = sum(name.startswith("f_rest") for name in names) // 3
    sh = columns(*(f"f_dc_{i}" for i in range(3)))[:, None, :]
    if rest:
        higher = columns(*(f"f_rest_{i}" for i in range(3 * rest)))
        sh = torch.cat([sh, higher.reshape(-1, 3, rest).transpose(1, 2)], 1)
    parameters = [
        columns("x", "y", "z"),
        columns(*(f"rot_{i}" for i in range(4))),
        columns(*(f"scale_{i}" for i in range(3))).exp(),
        columns("opacity")[:, 0].sigmoid(),
        sh.contiguous(),
    ]
    return parameters, {0: 0, 3: 1, 8: 2, 15: 3}[rest]


def camera(path, width, height):
    entry = json.load(open(path))[0]
    rotation, position = np.array(entry["rotation"]), np.array(entry["position"])
    view = np.eye(4)
    view[:3, :3] = rotation.T
    view[:3, 3] = -rotation.T @ position
    scale = width / entry["width"]
    lens = [[entry["fx"] * scale, 0, width / 2], [0, entry["fy"] * scale, height / 2], [0, 0, 1]]
    return [torch.tensor(np.array(m), dtype=torch.float32, device="cuda")[None] for m in (view, lens)]


def median_ms(work):
    times = []
    for i in range(WARM_UP + MEASURED):
        begin, end = (torch.cuda.Event(enable_timing=True) for _ in range(2))
        begin.record()
        work()
        end.record()
        end.synchronize()
        if i >= WARM_UP:
            times.append(begin.elapsed_time(end))
    return sorted(times)[MEASURED // 2]


def main(path, cameras, width, height, picture=None):
    parameters, degree = scene(path)
    view, lens = camera(cameras, width, height)

    def draw(packed):
        return rasterization(*parameters, view, lens, width, height, sh_degree=degree, packed=packed)[0]

    if picture:
        from PIL import Image

        with torch.no_grad():
            pixels = (draw(False)[0].clamp(0, 1) * 255 + 0.5).to(torch.uint8)
        Image.fromarray(pixels.cpu().numpy()).save(picture)
    for packed in (False, True):
        with torch.no_grad():
            print(f"packed {packed}: forward {median_ms(lambda: draw(packed)):.3f} ms", flush=True)
        parameters = [p.detach().requires_grad_(True) for p in parameters]
        target = torch.rand((1, height, width, 3), device="cuda")

        def both():
            for parameter in parameters:
                parameter.grad = None
            draw(packed).backward(target)

        print(f"packed {packed}: forward and backward {median_ms(both):.3f} ms", flush=True)


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2], int(sys.argv[3]), int(sys.argv[4]), *sys.argv[5:6])
