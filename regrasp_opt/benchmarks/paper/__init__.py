"""The figure and the tables of the paper, measured with this package."""
