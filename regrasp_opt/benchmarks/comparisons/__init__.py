"""Comparisons beyond the paper: ablations, refiners, embeddings, motions and speed."""
