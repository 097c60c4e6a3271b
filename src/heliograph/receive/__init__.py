"""Camera frames -> packets: detect, track, equalise, decode."""
