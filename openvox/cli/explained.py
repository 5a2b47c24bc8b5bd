"""What `explain` found, for people: sentences, and tables where numbers are compared."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from openvox.cli import tables

DECISION = ("mask", "caption", "by", "instance", "voxels", "s_geo", "s_fea", "a", "visibility", "credibility")
LISTED = 4
LATEST = 12
"""Rows of a long list that are shown; --json has all."""


def print_frame(data: tables.Data) -> None:
    """The decisions of one frame, each with its best candidates, and what they led to."""
    if not data["looked"]:
        print(f"frame {data['frame']}: perception did not look at it, so nothing was decided")
        return
    print(f"frame {data['frame']}: {len(data['decisions'])} masks")
    if data["decisions"]:
        tables.print_table(
            ["mask", "caption", "rule", "instance", "voxels", "S_geo", "S_fea", "A", "R", "w", "candidates by A"],
            [[*(decision[name] for name in DECISION), _candidates(decision)] for decision in data["decisions"]],
            f"threshold of A: {data['decisions'][0]['threshold']:.3f}",
        )
    for event in data["events"]:
        print(f"instance {event['instance']} {event['kind']}: {tables.cell(event['text'])}")


def _candidates(decision: tables.Data) -> str:
    """The best few, as instance and A."""
    texts = [f"{c['instance']}: {c['a']:.2f}" for c in decision["candidates"]]
    return "  ".join(texts[:LISTED]) + ("  ..." if len(texts) > LISTED else "")


def print_suspicious(data: tables.Data, trace: Path) -> None:
    """The list with a reason a row, and what to type for the first one."""
    if not data["decisions"]:
        print(
            "nothing is suspicious: no mask was mapped, all voxels show what their masks joined, or all captions agree"
        )
        return
    tables.print_table(
        ["frame", "mask", "instance", "score", "reason"],
        [[row[name] for name in ("frame", "mask", "instance", "score", "reason")] for row in data["decisions"]],
    )
    print(data["rule"])
    worst = data["decisions"][0]
    print(f"next: openvox explain {trace} --frame {worst['frame']} --mask {worst['mask']}")


def print_mask(data: tables.Data) -> None:
    """One decision: the verdict, the scores, the margins, where the votes lay, the evidence, what was and came."""
    print(f'frame {data["frame"]}, mask {data["mask"]} "{tables.cell(data["caption"])}": {data["verdict"]}')
    if data["instance_in_the_end"] != data["instance"]:
        print(f"instance {data['instance']} became part of instance {data['instance_in_the_end']}")
    for sign in data["signs"]:
        print(f"odd: {tables.cell(sign)}")
    scores = data["scores"]
    print(
        f"voxels {data['voxels']}, of which {data['voted']} gained votes for what it holds and {data['abstained']} "
        f"abstained; R {_q20(scores['visibility'])}, w {scores['credibility']:.3f}"
    )
    if data["candidates"]:
        tables.print_table(
            ["instance", "caption so far", "overlap", "S_geo", "S_fea", "A", "from S_geo", "from S_fea", ""],
            [
                [c["instance"], c["caption"], c["overlap"], c["s_geo"], c["s_fea"], c["a"], c["from_geometry"],
                 c["from_feature"], "<- chosen" if c["chosen"] else ""]
                for c in data["candidates"]
            ],
            f"A = {scores['weight_geometry']:g} S_geo + {scores['weight_feature']:g} S_fea; "
            f"threshold {_q20(scores['threshold'])}",
        )  # fmt: skip
    margins = {name.replace("_", " "): value for name, value in data["margin"].items() if value is not None}
    print("margins: " + (", ".join(f"{name} {value:+.3f}" for name, value in margins.items()) or "no candidate"))
    for part in data["contributions"]:
        _print_contributions(part)
    _print_evidence(data)
    _print_history(data["history"])


def _q20(value: float) -> str:
    """A score as the trace has it: an integer over 2^20."""
    return f"{value:.3f} ({round(value * 2**20)}/2^20)"


def _print_contributions(part: tables.Data) -> None:
    title = f"instance {part['instance']} had votes in {part['voxels_with_votes']} of those voxels; the largest shares"
    if part["largest"]:
        tables.print_table(
            ["x", "y", "z", "votes", "of", "share", "adds to S_geo"],
            [
                [*(f"{x:.2f}" for x in row["center"]), row["votes"], row["of"], row["share"], f"{row['of_s_geo']:.5f}"]
                for row in part["largest"]
            ],
            title,
        )


def _print_evidence(data: tables.Data) -> None:
    for one in data["evidence"]:
        alike = "no mask yet" if one["caption_likeness"] is None else f"caption likeness {one['caption_likeness']:.2f}"
        print(
            f"evidence, instance {one['instance']}{' (chosen)' if one['chosen'] else ''}: "
            f'{one["masks_before"]} masks before, mostly "{tables.cell(one["caption"])}", {alike}; '
            f"{one['voxels_owned_under_mask']} voxels under the mask are its; seen together with what else it holds "
            f"in {one['frames_together']} frames, apart in {one['frames_apart']}"
        )
    print(
        f"background: {data['background']['share_of_votes']:.2f} of the votes in those voxels; "
        f"{data['background']['voxels_without_votes']} of them had no vote yet"
    )


def _print_history(history: tables.Data) -> None:
    print(f"history: {history['masks_before']} masks before this frame, {history['masks_after']} after it")
    for name in ("events_before", "events_of_the_frame", "events_after"):
        print_events(history[name][-LISTED:] if name == "events_before" else history[name][:LISTED])


def print_events(events: Sequence[Any]) -> None:
    """One a line."""
    for event in events:
        others = f" with {tables.cell(event['others'])}" if event["others"] else ""
        line = f"  frame {event['frame']}: {event['kind']} instance {event['instance']}{others}: {event['text']}"
        print(tables.cell(line))


def print_instance(data: tables.Data) -> None:
    """An instance's life."""
    print(f"instance {data['instance']}: {data['state']}")
    if data["masks"]:
        print(f"{len(data['masks'])} masks, frames {data['first_frame']} to {data['last_frame']}")
    print(f"{data['voxels']} voxels by votes in the end")
    tables.print_table(["caption", "masks"], [[c["caption"], c["masks"]] for c in data["captions"][:LATEST]])
    if len(data["fragments"]) > 1:
        columns = ["fragment", "masks", "voxels_with_votes", "caption"]
        rows = [[part[name] for name in columns] for part in data["fragments"]]
        tables.print_table([name.replace("_", " ") for name in columns], rows, "fragments that are one now")
    columns = ["frame", "mask", "caption", "by", "a", "voxels", "fragment", "instance_then", "instance_in_the_end"]
    shown = (
        data["masks"] if len(data["masks"]) <= LATEST else data["masks"][: LATEST // 2] + data["masks"][-LATEST // 2 :]
    )
    left = f" (first and last {LATEST // 2} of {len(data['masks'])})" if len(shown) < len(data["masks"]) else ""
    tables.print_table(
        [name.replace("_", " ") for name in columns], [[row[name] for name in columns] for row in shown], f"masks{left}"
    )
    growth = data["growth"][:: max(1, len(data["growth"]) // LATEST)]
    print("growth: " + ", ".join(f"{step['voxels']} voxels in frame {step['frame']}" for step in growth))
    for other in data["sharing"]:
        print(
            f"shares {other['voxels']} voxels ({other['share']:.2f} of those with its votes) with {other['instance']}"
        )
    print_events(data["events"])


def print_voxel(data: tables.Data) -> None:
    """What happened to a voxel, frame by frame, and what it holds now."""
    center = ", ".join(f"{x:.2f}" for x in data["center"])
    print(f"voxel {tables.cell(data['voxel'])}, center {center} m")
    rows = []
    for step in data["history"]:
        owner = _owner(step["owner"])
        changed = f"{_owner(step['owner_before'])} -> {owner}" if step["owner"] != step["owner_before"] else owner
        rows.append([step["frame"], changed, "; ".join(map(_vote, step["votes"])) or "its instance changed its name"])
    tables.print_table(["frame", "owner", "votes"], rows)
    now = data["now"]
    gone = f" (finishing dropped it: {now['dropped']})" if now["dropped"] else ""
    print(f"in the end: {_owner(now['owner'])}{gone}")
    tables.print_table(
        ["instance", "fragment", "votes", "share"],
        [[_owner(v["instance"]), v["fragment"], v["votes"], v["share"]] for v in now["votes"]],
    )


def _owner(instance: int) -> str:
    return str(instance) if instance else "background"


def _vote(vote: tables.Data) -> str:
    what = "background" if vote["fragment"] == 0 else f"fragment {vote['fragment']}"
    masks = " or ".join(f'mask {m} "{caption}"' for m, caption in zip(vote["masks"], vote["captions"], strict=True))
    return f"{what} {vote['votes_before']:g} -> {vote['votes']:g}{f' by {masks}' if masks else ''}"
