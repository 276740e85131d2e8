"""Pick-and-place motions for a plan: paths, time parameterization, continuous collision check, smoothing."""
