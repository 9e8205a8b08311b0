"""Reader of Conv: over so short a history it is a matrix, most of whose weights are 0."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import numpy as np

from neuroflight.toolchain.reader.arithmetic import linear
from neuroflight.toolchain.reader.values import Call, RowValue

PADDED_MAX = 1 << 16  # values with the zeros around them, which also bounds the kernel


def read_conv(call: Call) -> RowValue:
    """Read a convolution over any number of axes, of a value of shape [1, channels, ...]."""
    row, weight = call.row(0), call.floats(1)
    if weight is None or weight.ndim != len(row.shape) or weight.ndim < 3 or row.shape[0] != 1:
        got = "none" if weight is None else list(weight.shape)
        raise call.error(f"convolves a value of shape {list(row.shape)} with weights of shape {got}")
    groups, kernel, count = call.attributes.get("group", 1), weight.shape[2:], len(row.shape) - 2
    strides, dilations = (_sizes(call, name, count) for name in ("strides", "dilations"))
    if groups < 1 or row.shape[1] != groups * weight.shape[1] or weight.shape[0] % groups:
        raise call.error(
            f"has weights for {groups * weight.shape[1]} channels in {groups} group(s), got {row.shape[1]}"
        )
    spans = [dilation * (size - 1) + 1 for dilation, size in zip(dilations, kernel, strict=True)]
    pads = _pads(call, row.shape[2:], spans, strides)
    room = [n + sum(p) - span for n, p, span in zip(row.shape[2:], pads, spans, strict=True)]
    sizes = [space // stride + 1 for space, stride in zip(room, strides, strict=True)]
    if min(room) < 0 or call.attributes.get("kernel_shape", list(kernel)) != list(kernel):
        raise call.error(f"has a kernel of {list(kernel)} values for a value of shape {list(row.shape)}")
    if row.shape[1] * math.prod(n + sum(p) for n, p in zip(row.shape[2:], pads, strict=True)) > PADDED_MAX:
        raise call.error(f"pads its value to more than {PADDED_MAX} values; is it a policy?")
    shape = (1, weight.shape[0], *sizes)
    call.afford(math.prod(shape) * row.width)
    padded = np.pad(row.places[0], [(0, 0), *pads], constant_values=-1)
    outputs = np.arange(math.prod(shape)).reshape(groups, -1, *sizes)
    matrix = np.zeros((math.prod(shape), row.width))
    for group, channel, *offsets in itertools.product(
        range(groups), range(weight.shape[1]), *(range(size) for size in kernel)
    ):
        windows = tuple(
            slice(offset * dilation, offset * dilation + (size - 1) * stride + 1, stride)
            for offset, dilation, size, stride in zip(offsets, dilations, sizes, strides, strict=True)
        )
        taken = padded[group * weight.shape[1] + channel][windows]
        factors = np.moveaxis(np.split(weight, groups)[group][:, channel], 0, -1)[tuple(offsets)]
        for output, factor in zip(outputs[group], factors, strict=True):
            matrix[output[taken >= 0], taken[taken >= 0]] += factor
    bias = call.numbers(2)
    bias = np.zeros(weight.shape[0]) if bias is None else bias
    if bias.shape != weight.shape[:1]:
        raise call.error(f"has a bias of shape {list(bias.shape)}, expected [{weight.shape[0]}]")
    return linear(call, row, matrix, np.repeat(bias, math.prod(sizes)), shape)


def _sizes(call: Call, name: str, count: int) -> list[int]:
    sizes = list(call.attributes.get(name, [1] * count))
    if len(sizes) != count or min(sizes) < 1:
        raise call.error(f"has {name} {sizes}, expected {count} of 1 or more")
    return sizes


def _pads(
    call: Call, sizes: Sequence[int], spans: Sequence[int], strides: Sequence[int]
) -> list[tuple[int, int]]:
    """Return the number of zeros before and after each axis."""
    kind = call.attributes.get("auto_pad", b"NOTSET")
    if kind in (b"SAME_UPPER", b"SAME_LOWER"):
        pads = []
        for size, span, stride in zip(sizes, spans, strides, strict=True):
            missing = max((-(-size // stride) - 1) * stride + span - size, 0)
            less, more = missing // 2, missing - missing // 2
            pads.append((less, more) if kind == b"SAME_UPPER" else (more, less))
        return pads
    given = (
        list(call.attributes.get("pads", [0] * 2 * len(sizes))) if kind == b"NOTSET" else [0] * 2 * len(sizes)
    )
    if len(given) != 2 * len(sizes) or min(given) < 0 or max(given) > PADDED_MAX:
        raise call.error(f"has pads {given}, expected {2 * len(sizes)} of 0 or more")
    return list(zip(given[: len(sizes)], given[len(sizes) :], strict=True))
