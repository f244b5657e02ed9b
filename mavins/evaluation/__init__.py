"""Judging estimates against truth. Nothing that estimates knows of this room."""
