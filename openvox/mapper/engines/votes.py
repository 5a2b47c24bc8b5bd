"""The sparse votes alpha of all voxels: kernels for the CPU.

A voxel is a row: its key, its background count, and the head of a list of slots (fragment, count, next). Lists have no
limit, so no vote is ever lost. Nothing depends on the place of a row in the table or of a slot in its list.
"""

from __future__ import annotations

import numpy as np

from openvox.mapper import equations
from openvox.mapper.engines.compiled import kernel
from openvox.mapper.engines.pixels import EMPTY, find

instance_vector = kernel(equations.instance_vector)
count_votes = kernel(equations.count_votes)


@kernel
def strongest(head, fragment, count, following):
    """Fragment with most votes in a list and its votes, the lowest id on a tie; (0, 0) if the list is empty."""
    best, votes = 0, 0
    slot = head
    while slot != EMPTY:
        if count[slot] > votes or (count[slot] == votes and fragment[slot] < best):
            best, votes = fragment[slot], count[slot]
        slot = following[slot]
    return best, votes


@kernel
def total_votes(background, head, count, following):
    """All votes of a voxel, background included."""
    total = np.int64(background)
    slot = head
    while slot != EMPTY:
        total += count[slot]
        slot = following[slot]
    return total


@kernel
def look_up(keys_seen, table, keys, heads, backgrounds, fragment, count, following, hidden_evidence, limit):
    """What the map holds where the frame looks.

    Returns, for each key: row (EMPTY if new), owner (strongest fragment if it beats background, else 0), and label
    (the same with hidden_evidence x votes against background). limit > 0: the background count is no rival."""
    n = keys_seen.size
    rows = np.empty(n, np.int32)
    owner = np.zeros(n, np.int32)
    label = np.zeros(n, np.int32)
    for i in range(n):
        row = find(table, keys, keys_seen[i])
        rows[i] = row
        if row == EMPTY:
            continue
        best, votes = strongest(heads[row], fragment, count, following)
        against = backgrounds[row] if limit == 0 else 0
        if votes > against:
            owner[i] = best
        if hidden_evidence * votes > against:
            label[i] = best
    return rows, owner, label


@kernel
def fragments_there(rows, heads, fragment, following, number, found):
    """Numbers the fragments that have votes in any of the rows, in order of appearance, into `found`.

    number: (fragments + 1,) int32, EMPTY everywhere before; it holds each fragment's number after."""
    n = 0
    for row in rows:
        if row == EMPTY:
            continue
        slot = heads[row]
        while slot != EMPTY:
            if number[fragment[slot]] == EMPTY:
                number[fragment[slot]] = n
                found[n] = fragment[slot]
                n += 1
            slot = following[slot]
    return n


@kernel
def shares(pair_voxel, pair_mask, rows, label, masks, columns, number, heads, backgrounds, fragment, count, following):
    """Per mask and fragment: sum of theta in Q20 over the mask's voxels, and the mask's voxels with that label.

    pair_*: (voxel, mask) pairs, mask == masks for "under no mask". number: column of a fragment.
    Returns theta_sum (masks + 1, columns) int64, overlap (masks + 1, columns) int64."""
    theta_sum = np.zeros((masks + 1, columns), np.int64)
    overlap = np.zeros((masks + 1, columns), np.int64)
    for p in range(pair_voxel.size):
        voxel, mask = pair_voxel[p], pair_mask[p]
        row = rows[voxel]
        if row == EMPTY:
            continue
        if label[voxel] != 0:
            overlap[mask, number[label[voxel]]] += 1
        if mask == masks:
            continue
        total = total_votes(backgrounds[row], heads[row], count, following)
        slot = heads[row]
        while slot != EMPTY:
            theta_sum[mask, number[fragment[slot]]] += instance_vector(np.int64(count[slot]), total)
            slot = following[slot]
    return theta_sum, overlap


@kernel
def choose_targets(
    pair_voxel, pair_mask, rows, label, masks, number, held, main, undecided, matched, voxel_votes,
    heads, fragment, count, following,
):  # fmt: skip
    """The fragment that each (voxel, mask) pair votes for: > 0, 0 = background, EMPTY = nothing.

    held: (masks, columns) bool, the mask holds the fragment; main: (masks,) the fragment of what is new;
    undecided: (masks,) bool, what is new votes for nothing; matched: (columns,) bool, some mask holds it.
    A voxel under no mask votes for background if its fragment is matched (the detector saw the thing and left this
    voxel out) or if it has none; an unmatched fragment may have been missed."""
    target = np.empty(pair_voxel.size, np.int32)
    for p in range(pair_voxel.size):
        voxel, mask = pair_voxel[p], pair_mask[p]
        own = label[voxel]
        if mask == masks:
            target[p] = 0 if own == 0 or matched[number[own]] else EMPTY
            continue
        if not voxel_votes:
            target[p] = main[mask]
            continue
        if own != 0 and held[mask, number[own]]:
            target[p] = own
            continue
        best, votes = 0, 0
        if rows[voxel] != EMPTY:
            slot = heads[rows[voxel]]
            while slot != EMPTY:
                if held[mask, number[fragment[slot]]] and (
                    count[slot] > votes or (count[slot] == votes and fragment[slot] < best)
                ):
                    best, votes = fragment[slot], count[slot]
                slot = following[slot]
        if best == 0 and not undecided[mask]:
            best = main[mask]
        target[p] = best if best != 0 else EMPTY
    return target


@kernel
def add_votes(rows, targets, amounts, heads, backgrounds, fragment, count, following, state, limit):
    """Count a list of votes. state: [slots used, first free slot]; there is room for one new slot a vote.

    limit > 0: a list holds so many fragments at most; votes for others join the background count, and their target
    becomes 0."""
    for p in range(rows.size):
        row, target = rows[p], targets[p]
        if target == 0:
            backgrounds[row] = count_votes(backgrounds[row], amounts[p])
            continue
        slot, length = heads[row], 0
        while slot != EMPTY and fragment[slot] != target:
            slot = following[slot]
            length += 1
        if slot == EMPTY and 0 < limit <= length:
            backgrounds[row] = count_votes(backgrounds[row], amounts[p])
            targets[p] = 0
            continue
        if slot == EMPTY:
            slot = state[1]
            if slot == EMPTY:
                slot = state[0]
                state[0] += 1
            else:
                state[1] = following[slot]
            fragment[slot], count[slot], following[slot] = target, 0, heads[row]
            heads[row] = slot
        count[slot] = count_votes(count[slot], amounts[p])


@kernel
def move_votes(rows, source, target, heads, fragment, following):
    """Rename the votes for `source` to the new fragment `target`."""
    for row in rows:
        slot = heads[row]
        while slot != EMPTY:
            if fragment[slot] == source:
                fragment[slot] = target
            slot = following[slot]


@kernel
def halve(rows, limit, heads, backgrounds, fragment, count, following, state, changed_row, changed_fragment):
    """Halve, rounding down, all counts of the rows that hold more than `limit`; slots at 0 are freed.

    Fills changed_* with what changed (room for all slots of the rows and their backgrounds); returns how many."""
    n = 0
    for row in rows:
        if total_votes(backgrounds[row], heads[row], count, following) <= limit:
            continue
        backgrounds[row] >>= 1
        changed_row[n], changed_fragment[n] = row, 0
        n += 1
        previous, slot = EMPTY, heads[row]
        while slot != EMPTY:
            after = following[slot]
            changed_row[n], changed_fragment[n] = row, fragment[slot]
            n += 1
            count[slot] >>= 1
            if count[slot] == 0:
                if previous == EMPTY:
                    heads[row] = after
                else:
                    following[previous] = after
                following[slot] = state[1]
                state[1] = slot
            else:
                previous = slot
            slot = after
    return n


@kernel
def counts_of(rows, fragments, heads, backgrounds, fragment, count, following):
    """The votes of each (row, fragment), fragment 0 = background: (n,) int32."""
    out = np.zeros(rows.size, np.int32)
    for i in range(rows.size):
        if fragments[i] == 0:
            out[i] = backgrounds[rows[i]]
            continue
        slot = heads[rows[i]]
        while slot != EMPTY:
            if fragment[slot] == fragments[i]:
                out[i] = count[slot]
            slot = following[slot]
    return out


@kernel
def owners(rows, heads, backgrounds, fragment, count, following, limit):
    """Owner of each row and its share of all votes in Q20 (background's where there is no owner); 0 for EMPTY rows."""
    owner = np.zeros(rows.size, np.int32)
    share = np.zeros(rows.size, np.int32)
    for i in range(rows.size):
        row = rows[i]
        if row == EMPTY:
            continue
        best, votes = strongest(heads[row], fragment, count, following)
        if votes > (backgrounds[row] if limit == 0 else 0):
            owner[i] = best
        else:
            votes = backgrounds[row]
        total = total_votes(backgrounds[row], heads[row], count, following)
        if total > 0:
            share[i] = instance_vector(np.int64(votes), total)
    return owner, share


@kernel
def all_votes(rows, heads, backgrounds, fragment, count, following, slots):
    """Every vote of the first `rows` rows: row, fragment (0 = background), count, in no particular order."""
    out_row = np.empty(rows + slots, np.int32)
    out_fragment = np.empty(rows + slots, np.int32)
    out_count = np.empty(rows + slots, np.int32)
    n = 0
    for row in range(rows):
        if backgrounds[row] > 0:
            out_row[n], out_fragment[n], out_count[n] = row, 0, backgrounds[row]
            n += 1
        slot = heads[row]
        while slot != EMPTY:
            out_row[n], out_fragment[n], out_count[n] = row, fragment[slot], count[slot]
            n += 1
            slot = following[slot]
    return out_row[:n], out_fragment[:n], out_count[:n]
