"""Logs: recorded MAVLink in and out, and what can be read off it without a filter."""
