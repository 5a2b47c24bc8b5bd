"""Enc(SegCap(Det(C))): stages from images to masks, captions, embeddings, each run once and cached."""
