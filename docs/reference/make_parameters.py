"""Write docs/reference/parameters.md from the table of parameters itself.

python docs/reference/make_parameters.py
"""

from __future__ import annotations

from pathlib import Path

from mavins.config import Config
from mavins.parameters import AUTO, TABLE, get
from mavins.parameters.names import NEEDS_RESTART

PAGE = Path(__file__).resolve().parent / "parameters.md"

HEAD = f"""\
# Parameters

<!-- Written by docs/reference/make_parameters.py; a test keeps it in step. -->

Every setting of the [configuration](configuration.md) is a MAVLink parameter too, of the vehicle that `mavins serve`
speaks for: a ground station lists, reads and sets them.

- **Values.** Each is a 32-bit float (`MAV_PARAM_TYPE_REAL32`), whatever type a client claims: false and true are 0 and
  1, a choice is its place in the list below, and {AUTO:g} stands for `auto`. A vector is one parameter for each
  component. To set one component of a vector that is `auto` makes the others 0; to set one to {AUTO:g} makes the whole
  vector `auto`.
- **Setting.** What is out of range, not whole where it must be, or not finite is refused with a PARAM_ERROR, and a
  text says what is allowed. The value that holds is told to everybody, whatever has become of the request. Requests
  that change something are taken from this host only, unless the service is told otherwise.
- **Live.** A change is in force at once, at its place among the packets: `mavins replay` of a recording repeats it
  there. Another filter takes state and covariance over; a change of a noise, of a filter's own settings or of
  `GNSS_RESET_AFTER` does so as well, and measurements that belong before the change are not fused any more. While the
  delay of GNSS is estimated, a change of `GNSS_DELAY` begins the estimate anew from there. A filter that was never
  compiled on this machine is refused: compiling would stop the service (`mavins warmup --filter all`).
- **After a restart.** These are kept and told, but come into force at the next start, once they are saved.
- **Saving.** `MAV_CMD_PREFLIGHT_STORAGE` (245) with param1 = 1 writes the whole configuration to the file that the
  service was started with (`--config FILE`), whole or not at all; 0 goes back to what was saved last, 2 to what this
  run has begun with. The file's own comments give way to those that `mavins config` writes.

## Why some need a restart

"""


def page() -> str:
    """The whole page."""
    parts = [HEAD]
    parts += [f"- `{place}`: {reason}\n" for place, reason in NEEDS_RESTART.items()]
    parts.append("\n## All parameters\n\n| name | default | setting | allowed | live |\n")
    parts.append("|---|---|---|---|---|\n")
    config = Config()
    for parameter in TABLE.values():
        axis = "" if parameter.component < 0 else f"[{parameter.component}]"
        default = f"{get(config, parameter.name):.12g}"
        live = "yes" if parameter.live else "after a restart"
        parts.append(
            f"| `{parameter.name}` | {default} | `{parameter.path}`{axis}: {parameter.text} "
            f"| {parameter.allowed} | {live} |\n"
        )
    return "".join(parts)


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
