"""The receiver "soft": equaliser, cancellation and turbo decoder over whole packets."""
