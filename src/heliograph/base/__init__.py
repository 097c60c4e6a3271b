"""What every floor stands on: errors, frames, checked settings."""
