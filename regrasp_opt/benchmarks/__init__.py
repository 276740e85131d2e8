"""Reproducible figures: a harness, the experiments of the paper and further comparisons."""
