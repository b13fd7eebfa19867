"""The errors that a caller may want to handle; each message names the cause and the remedy."""


class GraycastError(Exception):
    """Base of the errors below. Its text is one line that can be shown to a user."""


class ConfigError(GraycastError):
    """A configuration, rig or calibration file has content that Graycast cannot use."""


class ArgumentError(ConfigError, ValueError):
    """A script gives a setting or an argument with a wrong name, kind or value."""


class MeshError(GraycastError):
    """A mesh file cannot be a part: it is empty, open, inside out or of impossible size."""


class DeviceError(GraycastError):
    """No render device is usable: there is no LLVM library, or no NVIDIA driver."""


class WorkerDied(GraycastError):
    """A worker process or its machine was lost in the middle of a scene."""


class DropError(GraycastError):
    """Parts did not come to an acceptable rest in the bin within the allowed tries."""


class DatasetError(GraycastError):
    """A dataset folder or one of its files has wrong content, or belongs to another run."""


class DecodeError(GraycastError):
    """A stack's frames are missing, do not fit together, or do not fit the code."""


class ScannerError(GraycastError):
    """A virtual scanner cannot do this now: it is not connected, or its camera gets no light."""


def one_line(error: Exception) -> str:
    """Return an error's message as one line, or the name of its class if it has no message."""
    return " ".join(str(error).split()) or type(error).__name__


def error_line(error: Exception) -> str:
    """Return an error as one line, which begins with the path for operating-system errors."""
    text = one_line(error)
    if not isinstance(error, OSError):
        return text
    if error.filename is not None and error.strerror:
        text = f"{error.filename}: {error.strerror.lower()}"
    return f"{text}: check the path, the permission to write there, and the free disk space"
