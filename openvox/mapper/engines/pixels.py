"""Depth pixels to voxels, with pixel counts by label: kernels for the CPU."""

from __future__ import annotations

from functools import partial

import numpy as np

from openvox.mapper.engines.compiled import kernel

EMPTY = -1


@partial(kernel, inline="always")
def mixed(key):
    """A key's bits stirred, so that neighbouring voxels do not crowd one part of a table."""
    x = np.uint64(key) * np.uint64(0x9E3779B97F4A7C15)
    x ^= x >> np.uint64(29)
    x *= np.uint64(0xBF58476D1CE4E5B9)
    return np.int64((x ^ (x >> np.uint64(32))) & np.uint64(0x7FFFFFFFFFFFFFFF))


@kernel
def find(table, keys, key):
    """Row of a key, or EMPTY."""
    mask = table.size - 1
    slot = mixed(key) & mask
    while True:
        row = table[slot]
        if row == EMPTY or keys[row] == key:
            return row
        slot = (slot + 1) & mask


@kernel
def insert(table, keys, row):
    """Enter a row whose key the table does not hold yet."""
    mask = table.size - 1
    slot = mixed(keys[row]) & mask
    while table[slot] != EMPTY:
        slot = (slot + 1) & mask
    table[slot] = row


@kernel
def insert_range(table, keys, start, end):
    """Enter rows start .. end - 1."""
    for row in range(start, end):
        insert(table, keys, row)


@kernel
def rebuilt(keys, rows, size):
    """A table of `size` (a power of two) over the first `rows` keys."""
    table = np.full(size, EMPTY, np.int32)
    for row in range(rows):
        insert(table, keys, row)
    return table


@kernel
def color_pixel(z, ray_x, ray_y, rotation, translation, camera, width, height):
    """Nearest colour pixel (column, row) of a depth pixel; (-1, -1) if out of the picture. z: mm; see projection."""
    px = (z * (rotation[0, 0] * ray_x + rotation[0, 1] * ray_y + (rotation[0, 2] << 18)) + translation[0]) >> 28
    py = (z * (rotation[1, 0] * ray_x + rotation[1, 1] * ray_y + (rotation[1, 2] << 18)) + translation[1]) >> 28
    pz = (z * (rotation[2, 0] * ray_x + rotation[2, 1] * ray_y + (rotation[2, 2] << 18)) + translation[2]) >> 28
    if pz <= 0:
        return -1, -1
    den = pz << 16
    u = (2 * (camera[0] * px + camera[2] * pz) + den) // (2 * den)
    v = (2 * (camera[1] * py + camera[3] * pz) + den) // (2 * den)
    if u < 0 or v < 0 or u >= width or v >= height:
        return -1, -1
    return u, v


@kernel
def count_pixels(depth, skip, labels, max_mm, x, y, a, b, c, registered, rotation, translation, camera, room):
    """V_m of all masks at once, eq. (6): the voxels that the frame sees, and the pixels of each label in each.

    depth (h, w) uint16 mm; skip (h, w) uint8, 1 = leave out; labels (H, W) int32 in colour pixels, < 0 = leave out;
    x, y, a, b, c, rotation, translation, camera (fx, fy, cx, cy): see mapper.projection. room: a power of two.
    Returns keys (n,) int64 in order of appearance, and entries: voxel (e,), label (e,), pixels (e,); whether `room`
    sufficed (else call again with twice as much; nothing here grows, so that the loop stays fast)."""
    height, width = depth.shape
    color_height, color_width = labels.shape
    mask = 2 * room - 1
    table = np.full(2 * room, EMPTY, np.int32)
    keys = np.empty(room, np.int64)
    first = np.empty(room, np.int32)  # first entry of each voxel
    entry_voxel = np.empty(room, np.int32)
    entry_label = np.empty(room, np.int32)
    entry_pixels = np.empty(room, np.int32)
    entry_next = np.empty(room, np.int32)
    a00, a10, a20, b0, b1, b2, c0, c1, c2 = a[0, 0], a[1, 0], a[2, 0], b[0], b[1], b[2], c[0], c[1], c[2]
    voxels, entries = 0, 0
    last_key, voxel, entry, last_label = np.int64(-1), np.int64(0), np.int64(0), np.int64(0)
    enough = True
    for v in range(height):
        row0 = a[0, 1] * y[v] + (a[0, 2] << 18)
        row1 = a[1, 1] * y[v] + (a[1, 2] << 18)
        row2 = a[2, 1] * y[v] + (a[2, 2] << 18)
        if voxels + width >= room or entries + width >= room:
            enough = False
            break
        for u in range(width):
            z = np.int64(depth[v, u])
            if z == 0 or z > max_mm or skip[v, u]:
                continue
            if registered:
                label = np.int64(labels[v, u])
            else:
                cu, cv = color_pixel(z, x[u], y[v], rotation, translation, camera, color_width, color_height)
                label = np.int64(labels[cv, cu]) if cu >= 0 else np.int64(-1)
            if label < 0:
                continue
            i = ((z * (row0 + a00 * x[u]) + c0) >> 46) + b0 + 1048576
            j = ((z * (row1 + a10 * x[u]) + c1) >> 46) + b1 + 1048576
            k = ((z * (row2 + a20 * x[u]) + c2) >> 46) + b2 + 1048576
            key = (i << 42) | (j << 21) | k
            if key == last_key and label == last_label:
                entry_pixels[entry] += 1
                continue
            if key != last_key:
                slot = mixed(key) & mask
                while table[slot] >= 0 and keys[table[slot]] != key:
                    slot = (slot + 1) & mask
                voxel = np.int64(table[slot])
                if voxel < 0:
                    voxel = np.int64(voxels)
                    keys[voxel], first[voxel], table[slot] = key, EMPTY, voxel
                    voxels += 1
            entry = np.int64(first[voxel])
            while entry >= 0 and entry_label[entry] != label:
                entry = np.int64(entry_next[entry])
            if entry < 0:
                entry = np.int64(entries)
                entry_voxel[entry], entry_label[entry], entry_pixels[entry] = voxel, label, 0
                entry_next[entry], first[voxel] = first[voxel], entry
                entries += 1
            entry_pixels[entry] += 1
            last_key, last_label = key, label
    n, e = voxels, entries
    return keys[:n].copy(), entry_voxel[:e].copy(), entry_label[:e].copy(), entry_pixels[:e].copy(), enough


@kernel
def majority(voxels, entry_voxel, entry_label, entry_pixels):
    """The label of most pixels in each voxel, the lowest label on a tie: (voxels,) int32."""
    best = np.zeros(voxels, np.int64)
    for entry in range(entry_voxel.size):
        rank = (np.int64(entry_pixels[entry]) << 32) | (0xFFFFFFFF - np.int64(entry_label[entry]))
        if rank > best[entry_voxel[entry]]:
            best[entry_voxel[entry]] = rank
    out = np.empty(voxels, np.int32)
    for voxel in range(voxels):
        out[voxel] = 0xFFFFFFFF - (best[voxel] & 0xFFFFFFFF)
    return out
