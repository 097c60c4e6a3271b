"""The benchmark: named receivers on named scenarios, with the sweep engine."""
