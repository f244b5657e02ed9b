"""Every error that mavins raises on purpose. A caller catches `MavinsError`; the CLI prints it as one line."""


class MavinsError(Exception):
    """The base of all errors that a user can do something about."""


class ConfigError(MavinsError):
    """A configuration key or value is wrong; the message names its dotted path and what is allowed."""


class ParameterError(ConfigError):
    """A parameter does not exist, or does not take this value; the message names what is allowed."""


class LogFormatError(MavinsError):
    """A log cannot be read as what it claims to be."""


class NotALogError(LogFormatError):
    """A file holds nothing of a log."""


class TransportError(MavinsError):
    """A socket, port or file that bytes should pass through cannot be opened or used."""


class OutputError(MavinsError):
    """A result cannot be written where the user asked for it."""


class ScenarioError(MavinsError):
    """A simulator scenario is unknown or does not make sense."""


class KeyFileError(MavinsError):
    """A signing key, or the timestamps beside it, cannot be used as they are; the message never holds the key."""
