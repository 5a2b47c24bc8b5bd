"""Masks to one label image: kernels for the CPU. Label 0 = under no mask, m + 1 = mask m, -1 = votes for nothing."""

from __future__ import annotations

import numpy as np

from openvox.mapper.engines.compiled import kernel

UNKNOWN = -1


@kernel
def paint(image, bits, x0, y0, x1, y1, label):
    """Write `label` into the int32 image wherever a mask's packed bits are set."""
    position = 0
    for v in range(y0, y1):
        for u in range(x0, x1):
            if bits[position >> 3] >> (7 - (position & 7)) & 1:
                image[v, u] = label
            position += 1


@kernel
def paint_combination(image, bits, x0, y0, x1, y1, after, made):
    """Add a mask to the combination image: combination c becomes after[c], made anew (from `made` up) when first met.

    after: (n,) int64, -1 where the combination was not met under this mask. Returns the new number of combinations."""
    position = 0
    for v in range(y0, y1):
        for u in range(x0, x1):
            if bits[position >> 3] >> (7 - (position & 7)) & 1:
                before = image[v, u]
                if after[before] < 0:
                    after[before] = made
                    made += 1
                image[v, u] = after[before]
            position += 1
    return made


@kernel
def common_pixels(bits_a, box_a, bits_b, box_b):
    """Pixels that two masks share."""
    x0, y0 = max(box_a[0], box_b[0]), max(box_a[1], box_b[1])
    x1, y1 = min(box_a[2], box_b[2]), min(box_a[3], box_b[3])
    width_a, width_b = box_a[2] - box_a[0], box_b[2] - box_b[0]
    common = 0
    for v in range(y0, y1):
        for u in range(x0, x1):
            i = (v - box_a[1]) * width_a + u - box_a[0]
            j = (v - box_b[1]) * width_b + u - box_b[0]
            if bits_a[i >> 3] >> (7 - (i & 7)) & 1 and bits_b[j >> 3] >> (7 - (j & 7)) & 1:
                common += 1
    return common


@kernel
def blur_borders(image, radius, uniform, out):
    """`out` = image, but UNKNOWN within `radius` pixels (square) of a pixel with another label.

    uniform: (h, w) uint8, scratch. Runs of equal labels are counted along rows, then along columns."""
    height, width = image.shape
    for v in range(height):
        run = 0
        for u in range(width):
            run = run + 1 if u > 0 and image[v, u] == image[v, u - 1] else 1
            uniform[v, u] = run > radius or run == u + 1
        run = 0
        for u in range(width - 1, -1, -1):
            run = run + 1 if u < width - 1 and image[v, u] == image[v, u + 1] else 1
            uniform[v, u] &= run > radius or run == width - u
    runs = np.zeros(width, np.int32)
    for v in range(height):
        for u in range(width):
            same = v > 0 and image[v, u] == image[v - 1, u]
            runs[u] = (runs[u] * same + 1) * uniform[v, u]
            out[v, u] = image[v, u] if runs[u] > radius or runs[u] == v + 1 else UNKNOWN
    runs[:] = 0
    for v in range(height - 1, -1, -1):
        for u in range(width):
            same = v < height - 1 and image[v, u] == image[v + 1, u]
            runs[u] = (runs[u] * same + 1) * uniform[v, u]
            if not (runs[u] > radius or runs[u] == height - v):
                out[v, u] = UNKNOWN


@kernel
def depth_steps(depth, margin, near, out):
    """`out` = 1 within `margin` pixels of a depth step: neighbours that differ by over 60 mm + 2 % of the nearer one.

    Both sides of a step are its first pixel. near: (h, w) uint8, scratch."""
    height, width = depth.shape
    out[:] = 0
    if margin == 0:
        return
    near[:] = 0
    for v in range(height):
        for u in range(width):
            z = np.int64(depth[v, u])
            if z == 0:
                continue
            if u + 1 < width and depth[v, u + 1] != 0:
                other = np.int64(depth[v, u + 1])
                if 50 * abs(z - other) > 3000 + min(z, other):
                    near[v, u] = 1
                    near[v, u + 1] = 1
            if v + 1 < height and depth[v + 1, u] != 0:
                other = np.int64(depth[v + 1, u])
                if 50 * abs(z - other) > 3000 + min(z, other):
                    near[v, u] = 1
                    near[v + 1, u] = 1
    reach = margin - 1
    for v in range(height):
        for u in range(width):
            if near[v, u]:
                for y in range(max(0, v - reach), min(height, v + reach + 1)):
                    for x in range(max(0, u - reach), min(width, u + reach + 1)):
                        out[y, x] = 1
