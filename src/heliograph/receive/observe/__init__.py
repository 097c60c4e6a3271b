"""What a pair of frames shows of its symbols: cut-outs, their noise, and sufficient statistics."""
