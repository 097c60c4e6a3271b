"""Error rates by distance, at rest and driving: films counted packet by packet, compared, judged and drawn."""
