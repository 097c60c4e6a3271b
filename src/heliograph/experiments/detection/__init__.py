"""False detections and identities: what the header and the number of frames add to the detector."""
