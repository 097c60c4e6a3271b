"""Messages of the road: a traffic light's phases as a SPATEM, its junction as a MAPEM, as plain values and back."""
