"""Transports move bytes and know no MAVLink."""
