"""How large everyday things are: a noun that does not fit a thing's size is not its name.

Written from general knowledge of the nouns that the shipped models know, with wide margins, not from any recording.
"""

from __future__ import annotations

import numpy as np

from openvox.core.types import Intrinsics, Mask
from openvox.perception.surface import Floats

SIZES = {
    "apple, orange, lemon, donut": (0.04, 0.15),
    "banana, sandwich, hot dog, carrot, broccoli": (0.06, 0.3),
    "pizza, cake": (0.1, 0.5),
    "cup, mug, glass, goblet, wine glass, coffee cup": (0.05, 0.25),
    "bottle, water bottle, wine bottle": (0.08, 0.45),
    "pill bottle, perfume, salt shaker, shaker, soap dispenser, hourglass": (0.04, 0.3),
    "jug, measuring cup, teapot, coffee pot": (0.08, 0.45),
    "bowl, plate": (0.08, 0.5),
    "fork, knife, spoon, wooden spoon, ladle, scissors, toothbrush": (0.08, 0.5),
    "pen": (0.05, 0.25),
    "pencil case": (0.08, 0.35),
    "candle": (0.03, 0.5),
    "pot, frying pan, wok, slow cooker, waffle iron, toaster": (0.12, 0.7),
    "tray": (0.15, 0.8),
    "mouse, computer mouse": (0.05, 0.2),
    "remote, remote control": (0.08, 0.35),
    "cell phone, mobile phone": (0.06, 0.25),
    "telephone": (0.1, 0.4),
    "keyboard": (0.2, 0.65),
    "laptop": (0.2, 0.6),
    "computer": (0.2, 0.9),
    "monitor": (0.2, 1.2),
    "tv, television": (0.25, 2.2),
    "printer, projector": (0.15, 0.9),
    "microphone": (0.08, 0.5),
    "radio, CD player, cassette player": (0.1, 0.9),
    "loudspeaker": (0.1, 1.6),
    "book, menu, binder, packet": (0.08, 0.5),
    "clock, digital clock": (0.05, 0.8),
    "scales": (0.1, 0.6),
    "iron, hair drier, hair dryer": (0.1, 0.5),
    "sewing machine, coffee machine, microwave": (0.2, 0.8),
    "oven, stove, dishwasher, washing machine": (0.4, 1.3),
    "refrigerator": (0.45, 2.3),
    "sink": (0.25, 1.4),
    "toilet": (0.35, 1.1),
    "bathtub": (0.9, 2.3),
    "radiator, heater": (0.2, 2.5),
    "fan": (0.15, 1.8),
    "vacuum cleaner, broom": (0.3, 1.8),
    "bucket, bin, basket, laundry basket": (0.15, 1.0),
    "cardboard box, crate, chest": (0.1, 1.5),
    "medicine cabinet": (0.25, 1.2),
    "filing cabinet, chest of drawers": (0.3, 2.0),
    "cabinet, TV cabinet": (0.3, 3.0),
    "bookcase": (0.4, 4.0),
    "wardrobe": (0.7, 4.0),
    "chair, folding chair": (0.3, 1.4),
    "armchair, rocking chair": (0.45, 1.6),
    "couch, sofa": (0.7, 4.0),
    "bench": (0.4, 3.0),
    "bed": (0.9, 2.8),
    "baby bed": (0.5, 1.7),
    "dining table, table, desk": (0.35, 4.0),
    "lamp": (0.1, 2.2),
    "vase": (0.06, 1.0),
    "potted plant": (0.08, 2.5),
    "cushion": (0.2, 0.9),
    "quilt": (0.4, 2.8),
    "towel, paper towel, cloth": (0.1, 1.8),
    "rug": (0.4, 5.0),
    "doormat": (0.25, 1.5),
    "curtain, shower curtain, window blind": (0.3, 4.0),
    "folding screen, sliding door": (0.6, 4.0),
    "bag, handbag, plastic bag, backpack": (0.1, 0.9),
    "suitcase": (0.25, 1.2),
    "umbrella": (0.2, 1.5),
    "shoe, sandal": (0.08, 0.5),
    "tie": (0.2, 1.6),
    "mask": (0.08, 0.5),
    "teddy bear": (0.08, 1.2),
    "jigsaw puzzle": (0.05, 1.0),
    "balloon, ball, sports ball": (0.03, 0.8),
    "dumbbell": (0.1, 0.6),
    "guitar": (0.4, 1.4),
    "violin": (0.3, 0.9),
    "piano": (0.6, 3.0),
    "drum": (0.15, 1.2),
    "cat, dog": (0.15, 1.3),
    "person": (0.3, 2.2),
    "accordion, typewriter": (0.2, 0.7),
    "cello, harp": (0.7, 2.0),
    "sunglasses": (0.04, 0.35),
    "toilet paper": (0.05, 0.35),
    "camera, game controller": (0.07, 0.3),
    "bell pepper, cucumber, mushroom, strawberry": (0.02, 0.35),
    "bread, pineapple": (0.06, 0.6),
    "flower": (0.05, 1.2),
    "newspaper": (0.15, 0.8),
    "tool box": (0.15, 0.8),
    "tripod": (0.15, 2.0),
    "bicycle": (0.7, 2.2),
    "racket": (0.25, 0.9),
    "hat, helmet": (0.12, 0.7),
    "gloves, boots": (0.08, 0.6),
    "scarf, apron": (0.15, 2.0),
    "clothes, suit": (0.15, 1.9),
    "sleeping bag": (0.3, 2.3),
    "toy": (0.03, 1.5),
}
"""Least and greatest of the largest extent, metres."""
SIZE_OF = {noun.strip(): span for nouns, span in SIZES.items() for noun in nouns.split(",")}
_SLANT = float(np.sqrt(0.5))
_DIRECTIONS = (
    *((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
    *((_SLANT, _SLANT, 0.0), (_SLANT, 0.0, _SLANT), (0.0, _SLANT, _SLANT)),
    *((_SLANT, -_SLANT, 0.0), (_SLANT, 0.0, -_SLANT), (0.0, _SLANT, -_SLANT)),
)
POINTS = 1000
"""So many points of a mask tell its size."""


def fits(noun: str, extent: float) -> bool:
    """Whether a thing of that largest extent (metres, 0 = unknown) may be one; of an unknown noun anything may."""
    least, most = SIZE_OF.get(noun, (0.0, np.inf))
    return not extent or least <= extent <= most


def extent_of(mask: Mask, z: Floats, camera: Intrinsics) -> float:
    """The largest extent of what is seen of a mask, metres, but for 2 % at either end; 0 where depth tells too little.

    z: (height, width) in colour pixels, metres, 0 = unknown. camera: the colour camera."""
    x0, y0, x1, y1 = mask.box
    row, column = np.nonzero(mask.crop() & (z[y0:y1, x0:x1] > 0))
    if len(row) < 20:
        return 0.0
    step = -(-len(row) // POINTS)
    row, column = row[::step] + y0, column[::step] + x0
    depth = z[row, column].astype(np.float64)
    x, y = (column - camera.cx) * depth / camera.fx, (row - camera.cy) * depth / camera.fy
    along = np.stack([a * x + b * y + c * depth for a, b, c in _DIRECTIONS])
    low, high = np.percentile(along, (2, 98), axis=1)
    return float((high - low).max())
