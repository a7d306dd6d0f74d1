"""The errors a user can cause or must be told of: each message is one or two clear lines."""


class TianimError(Exception):
    """Base of every error that the command line prints as a line, without a traceback.

    `exit_code` is 2 where the input is at fault and 1 where the run failed.
    """

    exit_code = 1


class SceneError(TianimError):
    """A scene, an override or an argument is wrong: names file, key, value and what is allowed."""

    exit_code = 2


class BlowupError(TianimError):
    """A simulated quantity left its bounds: names the system, the frame and the particle."""

    def __init__(self, system: str, particle: int, reason: str, frame: int | None = None) -> None:
        self.system, self.particle, self.reason, self.frame = system, particle, reason, frame
        where = "" if frame is None else f" in frame {frame}"
        super().__init__(f"{system}: particle {particle}{where}: {reason}")


class OutputError(TianimError):
    """Frames cannot be written: disk full, folder not writable, format cannot hold the frame."""


class FormatError(OutputError):
    """The format asked for cannot hold what the frame has, or is not known."""

    exit_code = 2


class MissingPartError(TianimError):
    """An optional part is not installed or not usable: names what to install."""

    exit_code = 2
