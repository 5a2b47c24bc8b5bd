"""Depth pixels to voxels, with pixel counts by label: kernels for the CPU."""

from __future__ import annotations

import numpy as np
from numba import njit

EMPTY = -1


@njit(cache=True, nogil=True, inline="always")
def mixed(key):
    """A key's bits stirred, so that neighbouring voxels do not crowd one part of a table."""
    x = np.uint64(key) * np.uint64(0x9E3779B97F4A7C15)
    x ^= x >> np.uint64(29)
    x *= np.uint64(0xBF58476D1CE4E5B9)
    return np.int64((x ^ (x >> np.uint64(32))) & np.uint64(0x7FFFFFFFFFFFFFFF))


@njit(cache=True, nogil=True)
def find(table, keys, key):
    """Row of a key, or EMPTY."""
    mask = table.size - 1
    slot = mixed(key) & mask
    while True:
        row = table[slot]
        if row == EMPTY or keys[row] == key:
            return row
        slot = (slot + 1) & mask


@njit(cache=True, nogil=True)
def insert(table, keys, row):
    """Enter a row whose key the table does not hold yet."""
    mask = table.size - 1
    slot = mixed(keys[row]) & mask
    while table[slot] != EMPTY:
        slot = (slot + 1) & mask
    table[slot] = row


@njit(cache=True, nogil=True)
def insert_range(table, keys, start, end):
    """Enter rows start .. end - 1."""
    for row in range(start, end):
        insert(table, keys, row)


@njit(cache=True, nogil=True)
def rebuilt(keys, rows, size):
    """A table of `size` (a power of two) over the first `rows` keys."""
    table = np.full(size, EMPTY, np.int32)
    for row in range(rows):
        insert(table, keys, row)
    return table


@njit(cache=True, nogil=True)
def color_pixel(px, py, pz, fx, fy, cx, cy, width, height):
    """Nearest pixel (column, row) of a point in the colour camera (Q16 millimetres); (-1, -1) if out of the picture."""
    if pz <= 0:
        return -1, -1
    den = pz << 16
    num = fx * px + cx * pz
    u = (2 * num + den) // (2 * den)
    num = fy * py + cy * pz
    v = (2 * num + den) // (2 * den)
    if u < 0 or v < 0 or u >= width or v >= height:
        return -1, -1
    return u, v


@njit(cache=True, nogil=True)
def count_pixels(depth, skip, labels, max_mm, x, y, a, b, c, registered, rotation, translation, camera, guess):
    """V_m of all masks at once, eq. (6): the voxels that the frame sees, and the pixels of each label in each.

    depth (h, w) uint16 mm; skip (h, w) uint8, 1 = leave out; labels (H, W) int32 in colour pixels, < 0 = leave out;
    x, y, a, b, c, rotation, translation, camera (fx, fy, cx, cy): see mapper.projection. guess: expected voxels.
    Returns keys (n,) int64 in order of appearance, and entries: voxel (e,), label (e,), pixels (e,)."""
    height, width = depth.shape
    color_height, color_width = labels.shape
    size = 1 << 10
    while size < 3 * guess:
        size *= 2
    table = np.full(size, EMPTY, np.int32)
    keys = np.empty(size, np.int64)
    first = np.empty(size, np.int32)  # first entry of each voxel
    entry_voxel = np.empty(size, np.int32)
    entry_label = np.empty(size, np.int32)
    entry_pixels = np.empty(size, np.int32)
    entry_next = np.empty(size, np.int32)
    voxels, entries = 0, 0
    last_key, voxel, entry, last_label = np.int64(-1), 0, 0, 0
    for v in range(height):
        row0 = a[0, 1] * y[v] + (a[0, 2] << 18)
        row1 = a[1, 1] * y[v] + (a[1, 2] << 18)
        row2 = a[2, 1] * y[v] + (a[2, 2] << 18)
        for u in range(width):
            z = np.int64(depth[v, u])
            if z == 0 or z > max_mm or skip[v, u]:
                continue
            if registered:
                label = labels[v, u]
            else:
                px = (
                    z * (rotation[0, 0] * x[u] + rotation[0, 1] * y[v] + (rotation[0, 2] << 18)) + translation[0]
                ) >> 28
                py = (
                    z * (rotation[1, 0] * x[u] + rotation[1, 1] * y[v] + (rotation[1, 2] << 18)) + translation[1]
                ) >> 28
                pz = (
                    z * (rotation[2, 0] * x[u] + rotation[2, 1] * y[v] + (rotation[2, 2] << 18)) + translation[2]
                ) >> 28
                cu, cv = color_pixel(px, py, pz, camera[0], camera[1], camera[2], camera[3], color_width, color_height)
                if cu < 0:
                    continue
                label = labels[cv, cu]
            if label < 0:
                continue
            i = ((z * (row0 + a[0, 0] * x[u]) + c[0]) >> 46) + b[0] + 1048576
            j = ((z * (row1 + a[1, 0] * x[u]) + c[1]) >> 46) + b[1] + 1048576
            k = ((z * (row2 + a[2, 0] * x[u]) + c[2]) >> 46) + b[2] + 1048576
            key = (i << 42) | (j << 21) | k
            if key == last_key and label == last_label:
                entry_pixels[entry] += 1
                continue
            if key != last_key:
                voxel = find(table, keys, key)
                if voxel == EMPTY:
                    if 2 * (voxels + 1) > table.size:
                        table = rebuilt(keys, voxels, table.size * 2)
                        keys, first = doubled(keys), doubled(first)
                    voxel = voxels
                    keys[voxel] = key
                    first[voxel] = EMPTY
                    insert(table, keys, voxel)
                    voxels += 1
            entry = first[voxel]
            while entry != EMPTY and entry_label[entry] != label:
                entry = entry_next[entry]
            if entry == EMPTY:
                if entries == entry_voxel.size:
                    entry_voxel, entry_label = doubled(entry_voxel), doubled(entry_label)
                    entry_pixels, entry_next = doubled(entry_pixels), doubled(entry_next)
                entry = entries
                entry_voxel[entry], entry_label[entry], entry_pixels[entry] = voxel, label, 0
                entry_next[entry], first[voxel] = first[voxel], entry
                entries += 1
            entry_pixels[entry] += 1
            last_key, last_label = key, label
    return (
        keys[:voxels].copy(),
        entry_voxel[:entries].copy(),
        entry_label[:entries].copy(),
        entry_pixels[:entries].copy(),
    )


@njit(cache=True, nogil=True)
def doubled(array):
    """The array with room for twice as much."""
    out = np.empty(2 * array.size, array.dtype)
    out[: array.size] = array
    return out


@njit(cache=True, nogil=True)
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
