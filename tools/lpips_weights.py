#!/usr/bin/env python3
"""Weights for `--lpips-weights`, and the fixture of the test of LPIPS.

For development: neither the program nor its tests run this. It needs torch, numpy and safetensors from PyPI:

    python3 -m venv v && v/bin/pip install torch numpy safetensors

Weights. Nothing is downloaded: give the two files that other programs already use. The network's are torchvision's
(`alexnet-owt-7be5be79.pth`, `vgg16-397923af.pth`), the heads' are in the package `lpips` (`lpips/weights/v0.1/alex.pth`,
`vgg.pth`):

    v/bin/python tools/lpips_weights.py alexnet-owt-7be5be79.pth alex.pth -o lpips_alex.safetensors
    v/bin/python tools/lpips_weights.py vgg16-397923af.pth vgg.pth -o lpips_vgg.safetensors

A state dictionary of the whole `lpips.LPIPS` module has both: give it alone. Mind the licences of the weights.

Fixture. `tests/golden/sets/lpips_torch.npz` holds what torch's own conv2d and max_pool2d give, in float64, for two pictures
and weights by a formula (that of tests/reference/lpips.rs, from other tags than the vectors of lpips_0):

    v/bin/python tools/lpips_weights.py --fixture tests/golden/sets/lpips_torch.npz
"""

import argparse
import re
import sys

import numpy as np
import torch
import torch.nn.functional as F

# (outputs, size, stride, padding), "tap" or ("pool", size); torchvision's index of each convolution.
ALEXNET = [(64, 11, 4, 2), "tap", ("pool", 3), (192, 5, 1, 2), "tap", ("pool", 3), (384, 3, 1, 1), "tap", (256, 3, 1, 1),
           "tap", (256, 3, 1, 1), "tap"]
VGG16 = [(64, 3, 1, 1), (64, 3, 1, 1), "tap", ("pool", 2), (128, 3, 1, 1), (128, 3, 1, 1), "tap", ("pool", 2),
         (256, 3, 1, 1), (256, 3, 1, 1), (256, 3, 1, 1), "tap", ("pool", 2), (512, 3, 1, 1), (512, 3, 1, 1), (512, 3, 1, 1),
         "tap", ("pool", 2), (512, 3, 1, 1), (512, 3, 1, 1), (512, 3, 1, 1), "tap"]
INDICES = {"alex": [0, 3, 6, 8, 10], "vgg": [0, 2, 5, 7, 10, 12, 14, 17, 19, 21, 24, 26, 28]}
STEPS = {"alex": ALEXNET, "vgg": VGG16}


def hashed(tag, count):
    x = (np.arange(count, dtype=np.uint64) + (np.uint64(tag) << np.uint64(24))).astype(np.uint32)
    x ^= x >> np.uint32(16)
    x = (x.astype(np.uint64) * 0x7FEB352D).astype(np.uint32)
    x ^= x >> np.uint32(15)
    x = (x.astype(np.uint64) * 0x846CA68B).astype(np.uint32)
    x ^= x >> np.uint32(16)
    return (x >> np.uint32(8)).astype(np.float32) * np.float32(2.0**-23) - np.float32(1)


def formula(steps, tags):
    """Weights and biases of the convolutions, weights of the heads."""
    convolutions, heads, inputs = [], [], 3
    for step in steps:
        if step == "tap":
            heads.append(np.abs(hashed(tags + 100 + len(heads), inputs)) / np.float32(4))
        elif step[0] != "pool":
            outputs, size, _, _ = step
            tag, fan_in = tags + 2 * len(convolutions), inputs * size * size
            weight = hashed(tag, outputs * fan_in) * np.float32(np.sqrt(6 / fan_in))
            bias = hashed(tag + 1, outputs) * np.float32(0.05)
            convolutions.append((weight.reshape(outputs, inputs, size, size), bias))
            inputs = outputs
    return convolutions, heads


def parts(steps, convolutions, heads, a, b):
    """The taps' parts of LPIPS of two pictures [3, height, width]."""
    shift = torch.tensor([-0.030, -0.088, -0.188], dtype=torch.float64).view(1, 3, 1, 1)
    scale = torch.tensor([0.458, 0.448, 0.450], dtype=torch.float64).view(1, 3, 1, 1)
    x = (torch.stack([a, b]) - shift) / scale
    convolutions, heads, found = iter(convolutions), iter(heads), []
    for step in steps:
        if step == "tap":
            normed = x / (x.square().sum(1, keepdim=True).sqrt() + 1e-10)
            head = torch.from_numpy(next(heads)).double().view(1, -1, 1, 1)
            found.append(F.conv2d((normed[:1] - normed[1:]).square(), head).mean().item())
        elif step[0] == "pool":
            x = F.max_pool2d(x, step[1], 2)
        else:
            weight, bias = (torch.from_numpy(array).double() for array in next(convolutions))
            x = F.relu(F.conv2d(x, weight, bias, stride=step[2], padding=step[3]))
    return found


def fixture(path):
    height, width, tag = 83, 59, 30
    # A smooth picture, and the same with noise, darker at one side.
    y, x = np.mgrid[0:height, 0:width]
    smooth = np.stack([127 + 120 * np.sin(x / 7 + c) * np.cos(y / (5 + c)) for c in range(3)], -1)
    noise = 60 * hashed(250, height * width * 3).reshape(height, width, 3)
    a = smooth.round().clip(0, 255).astype(np.uint8)
    b = ((smooth + noise) * (0.6 + 0.4 * x / width)[..., None]).round().clip(0, 255).astype(np.uint8)
    arrays = {"a": a, "b": b, "tag": np.array([tag], np.int32)}
    pictures = [torch.from_numpy(p.astype(np.float64) / 255).permute(2, 0, 1) for p in (a, b)]
    for name, first in (("alex", tag), ("vgg", tag + 64)):
        convolutions, heads = formula(STEPS[name], first)
        for suffix, values in (("", [2 * p - 1 for p in pictures]), ("_unscaled", pictures)):
            found = parts(STEPS[name], convolutions, heads, *values)
            print(f"{name}{suffix}: {sum(found):.9f}")
            arrays[f"{name}{suffix}_layers"] = np.array(found, np.float32)
            arrays[f"{name}{suffix}"] = np.array([sum(found)], np.float32)
    np.savez_compressed(path, **arrays)


def convert(paths, out):
    from safetensors.torch import save_file

    tensors = {}
    for path in paths:
        for name, tensor in torch.load(path, map_location="cpu", weights_only=True).items():
            network = re.fullmatch(r"(?:net\.slice\d+|features|net)\.(\d+)\.(weight|bias)", name)
            head = re.fullmatch(r"lin(\d)\.model\.1\.weight", name)
            if network:
                tensors[f"net.{network[1]}.{network[2]}"] = tensor.float().contiguous()
            elif head:
                tensors[name] = tensor.float().contiguous()
    for name, indices in INDICES.items():
        wanted = [f"net.{i}.{kind}" for i in indices for kind in ("weight", "bias")]
        wanted += [f"lin{k}.model.1.weight" for k in range(5)]
        if all(tensor in tensors for tensor in wanted) and tensors["net.0.weight"].shape[2] == STEPS[name][0][1]:
            save_file({tensor: tensors[tensor] for tensor in wanted}, out)
            print(f"{out}: LPIPS of {name}, {len(wanted)} tensors")
            return
    sys.exit(f"{', '.join(paths)}: not the weights of LPIPS with AlexNet or VGG16: network and heads are needed")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("weights", nargs="*", help="torchvision's and lpips' files, or one with both")
    parser.add_argument("-o", "--out", help="the safetensors file to write")
    parser.add_argument("--fixture", help="write the fixture here")
    arguments = parser.parse_args()
    if arguments.fixture:
        fixture(arguments.fixture)
    elif arguments.weights and arguments.out:
        convert(arguments.weights, arguments.out)
    else:
        parser.error("give the weights and -o, or --fixture")


main()
