"""The simulator: a vehicle of known motion with sensors that are wrong by known amounts.

`trajectory` is the motion with its exact derivatives, `imu`, `gnss` and `heading` the sensors,
`scenario` the YAML that joins them, `simulation` the stream of measurements and truth, `emitter`
its MAVLink packets. Frames, units and names are those of mavins.
"""
