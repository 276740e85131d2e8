"""Reproducible figures: the oracle, the baselines and the tables."""
