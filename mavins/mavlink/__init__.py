"""MAVLink: the codec, the clock of a vehicle, and the session that speaks it; no sockets."""
