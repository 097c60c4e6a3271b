"""Road messages: traffic light phases as SPATEM and junctions as MAPEM, to and from plain values."""
