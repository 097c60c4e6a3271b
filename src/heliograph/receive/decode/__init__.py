"""From soft values to codewords: one decoding a layer, or iterations between equaliser and decoder."""
