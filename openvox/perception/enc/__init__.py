"""Enc from model files of the user's: a file a family, a row of `perception/stages.py` each."""
