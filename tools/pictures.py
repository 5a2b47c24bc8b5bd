"""Draws a map, and a frame with detected beside rendered masks: python tools/pictures.py MAP FRAME FOLDER."""

import sys
from pathlib import Path

from openvox.apps.pictures import pictures

if __name__ == "__main__":
    map_file, frame, folder = sys.argv[1:]
    for path in pictures(Path(map_file), int(frame), Path(folder)).values():
        print(f"wrote {path}")
