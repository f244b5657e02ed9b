"""The configuration as MAVLink parameters: a fixed table of names, and values that are 32-bit floats on the wire.

names: which setting is called what; table: what each takes, reading and writing it; store: what one vehicle's
parameters are by now; metadata: the table as ground stations read it.
"""

from mavins.parameters.metadata import metadata
from mavins.parameters.store import ConfigStore, file_keeper
from mavins.parameters.table import AUTO, TABLE, Parameter, get, put, wire

__all__ = [
    "AUTO",
    "TABLE",
    "ConfigStore",
    "Parameter",
    "file_keeper",
    "get",
    "metadata",
    "put",
    "wire",
]
