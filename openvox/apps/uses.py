"""What everyday things are for: the bridge from a query that says a purpose to a caption that says a thing.

A caption stays what it is; a use is a second text that a query may meet. Written from general knowledge of the nouns
that the front ends know, before any query of a data set was read.
"""

from __future__ import annotations

from openvox.core.phrases import thing, words_of_thing

USES = {
    "chair, armchair, folding chair, rocking chair, office chair, stool, bench": "a seat to sit down on",
    "couch, sofa": "a soft seat for several people to sit, lie down and relax on",
    "bed": "a place to lie down, sleep and rest",
    "baby bed, cradle": "a place where a baby sleeps",
    "dining table": "a table to eat meals at and to put things on",
    "table, coffee table, side table, nightstand": "a surface to put things on",
    "desk": "a place to work, write and study",
    "bookcase, bookshelf": "a place to keep and store books",
    "shelf, shelves": "a place to store and display things",
    "cabinet, filing cabinet, medicine cabinet": "a place to store and put away things",
    "TV cabinet": "furniture that a television stands on",
    "chest, chest of drawers, dresser, drawer": "drawers to store clothes and things in",
    "wardrobe, closet": "a place to hang and store clothes",
    "box, cardboard box, crate, packet": "a container to pack, store or move things in",
    "basket, laundry basket": "a container for laundry or small things",
    "bin, waste bin, trash can": "a place to throw away rubbish and waste",
    "bucket": "a container to carry water, for cleaning",
    "lamp, floor lamp, table lamp, desk lamp": "something that gives light when it is dark, to read by",
    "candle": "a small flame that gives light",
    "cup, mug, coffee cup": "something to drink coffee, tea or a hot drink from",
    "glass, goblet, wine glass": "something to drink water or wine from",
    "bottle, water bottle": "a container that holds a drink",
    "wine bottle": "an alcoholic drink",
    "pill bottle": "medicine",
    "jug, measuring cup": "a container to pour liquid from",
    "teapot, coffee pot": "a pot to make and pour tea or coffee",
    "coffee machine": "a machine that makes coffee",
    "bowl, plate": "a dish for food and fruit",
    "fruit, apple, orange, banana, lemon": "a fresh fruit to eat, a healthy snack",
    "sandwich, hot dog, pizza, donut, cake": "food to eat, a snack",
    "broccoli, carrot": "a vegetable to eat or cook",
    "tray": "something to carry food and drinks on",
    "fork, spoon, wooden spoon, ladle": "cutlery to eat or stir food with",
    "knife, scissors": "a sharp tool to cut with",
    "pot, frying pan, wok, slow cooker": "cookware to cook food in",
    "salt shaker, shaker": "seasoning for food",
    "stove, oven, microwave, toaster, waffle iron": "a kitchen appliance to cook or heat food",
    "refrigerator": "a cold place to keep food fresh",
    "dishwasher": "a machine that cleans dishes",
    "sink": "a place to wash hands and dishes",
    "bathtub": "a place to take a bath",
    "toilet": "the toilet in a bathroom",
    "washing machine": "a machine that washes clothes",
    "iron": "an appliance to smooth wrinkled clothes",
    "sewing machine": "a machine to sew and mend clothes",
    "vacuum cleaner, broom": "a tool to clean the floor of dust",
    "towel, paper towel": "something to dry or wipe with",
    "soap dispenser": "soap to wash hands with",
    "toothbrush": "something to brush teeth with",
    "hair drier, hair dryer": "an appliance to dry wet hair",
    "perfume": "a nice scent to wear",
    "scales": "a device to weigh things on",
    "tv, television": "a screen to watch films, shows and news on",
    "monitor, screen": "a computer screen",
    "laptop, computer": "a computer to work, write and browse the internet with",
    "keyboard": "a device to type with",
    "mouse, computer mouse": "a device to point and click on a computer with",
    "printer": "a machine that prints documents on paper",
    "projector": "a device that shows films on a wall",
    "remote, remote control": "a device to change the channel or volume of a television",
    "cell phone, mobile phone, telephone": "a device to call and talk to someone far away",
    "loudspeaker, speaker, radio, CD player, cassette player, stereo": "a device that plays music and sound",
    "headphones": "something to listen to music in private with",
    "microphone": "a device to record a voice",
    "guitar, violin, piano, drum": "a musical instrument to play music on",
    "book, menu, binder, magazine": "something to read",
    "pen, pencil case": "something to write or draw with",
    "clock, digital clock, alarm clock, hourglass": "something that shows what time it is",
    "potted plant, plant": "a living green plant that needs water and decorates a room",
    "vase": "a container for flowers",
    "picture, painting, poster, photo frame": "decoration and art to look at on a wall",
    "cushion, pillow": "something soft to rest the head on",
    "quilt, blanket": "something to keep warm under in bed",
    "rug, doormat": "a soft cover for the floor to step on",
    "curtain, shower curtain, window blind": "something that covers a window and blocks the sun",
    "folding screen": "something that divides a room",
    "sliding door, door": "a way to enter or leave a room",
    "window": "a place to look outside and let fresh air in",
    "radiator, heater": "something that keeps the room warm",
    "fan": "a device that moves air to cool down",
    "bag, handbag, plastic bag": "something to carry things in when going out",
    "backpack": "a bag to carry things on the back, for school or hiking",
    "suitcase": "luggage to pack clothes in for a trip",
    "umbrella": "something that keeps off the rain",
    "shoe, sandal": "something to wear on the feet",
    "hat, tie, cloth, clothes": "clothing to wear",
    "mask": "something to cover the face with",
    "teddy bear, toy, jigsaw puzzle, balloon": "a toy for a child to play with or cuddle",
    "ball, sports ball": "a toy or sports gear to throw, kick and play with",
    "dumbbell": "a weight to exercise and get strong with",
    "cat, dog": "a pet animal",
    "accordion, cello, harp, harmonica": "a musical instrument to play",
    "cassette": "a tape with music",
    "game controller": "a device to play video games with",
    "hard disk, modem": "a part of a computer",
    "camera, tripod": "something to take photographs with",
    "typewriter": "a machine to write letters with",
    "newspaper": "something to read the news in",
    "envelope": "something to send a letter in",
    "eraser, pencil sharpener, ruler": "something to draw and write with at a desk",
    "paintbrush": "a tool to paint with",
    "magnifying glass": "something to see small things larger",
    "watch": "something worn on the wrist that shows what time it is",
    "wallet, piggy bank, safe": "a place to keep money",
    "padlock": "something to lock a door with",
    "light switch": "something to turn the light on and off",
    "lighter, match": "something to light a candle or fire with",
    "hammer, screwdriver, drill, tool box": "a tool to repair things with",
    "hook": "something to hang clothes on",
    "can opener, corkscrew": "a kitchen tool to open a can or bottle with",
    "spatula, strainer, mortar": "a kitchen tool to prepare food with",
    "dish rack": "a place where washed dishes dry",
    "barrel": "a large container for a drink",
    "bread, bell pepper, cucumber, mushroom": "food to eat",
    "strawberry, pineapple": "a fresh fruit to eat, a healthy snack",
    "flower": "a plant that smells nice and decorates a room",
    "lotion bottle, lipstick": "something to care for the skin",
    "spray bottle": "something to clean with",
    "toilet paper": "paper to wipe with in a bathroom",
    "plunger": "a tool to unblock a toilet",
    "stethoscope": "something a doctor listens to the heart with",
    "bib, diaper, pacifier": "something for a baby",
    "boots, sock": "something to wear on the feet",
    "gloves, scarf": "something to wear in the cold",
    "helmet": "something that protects the head",
    "apron, suit": "clothing to wear at work",
    "sunglasses": "something that protects the eyes from the sun",
    "sleeping bag": "something to sleep in when camping",
    "bicycle": "a vehicle to ride",
    "racket": "sports gear to play tennis with",
    "fire screen": "something that keeps sparks of a fire in",
    "person": "a human being",
}

USE_OF = {noun.strip().lower(): use for nouns, use in USES.items() for noun in nouns.split(",")}
ANOTHER_THING = frozenset(
    {"hot dog", "fire screen", "folding screen", "sleeping bag", "tool box", "magnifying glass", "waffle iron"}
)
"""Nouns whose last word names something that they are no kind of."""
_LONGEST = max(len(noun.split()) for noun in USE_OF)


def use_of(caption: str) -> str:
    """What the thing of a caption is for, "" if that is not known: "a white coffee cup on a table" is a cup."""
    words = words_of_thing(caption.lower().strip(" ."))
    return USE_OF.get(_known(words), "")


def noun_of(caption: str) -> str:
    """The thing of a caption, in one word where its name is not known: "a tall white bookcase full of books" is a
    bookcase, "a pair of running shoes" shoes; "" without words."""
    words = thing(caption.lower())
    return _known(words) or (words[-1] if words else "")


def in_short(caption: str) -> str:
    """The caption without the kind of its thing, "a beige table" of "a beige dining table on a rug"; "" where there is
    no kind, or what is left would be another thing."""
    words = words_of_thing(caption.lower().strip(" ."))
    noun = _known(words)
    kind, _, last = noun.rpartition(" ")
    if not kind or last not in USE_OF or noun in ANOTHER_THING:
        return ""
    return " ".join((*words[: len(words) - len(noun.split())], last))


def _known(words: list[str]) -> str:
    """The longest end of the words that is a thing whose use is known, or nothing."""
    for length in range(min(_LONGEST, len(words)), 0, -1):
        name = " ".join(words[-length:])
        if name in USE_OF:
            return name
    return ""
