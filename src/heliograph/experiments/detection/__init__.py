"""False detections, identities and acquisition."""
