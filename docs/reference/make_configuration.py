"""Write docs/reference/configuration.md from the settings themselves.

python docs/reference/make_configuration.py
"""

from __future__ import annotations

from pathlib import Path

from mavins.config import default_yaml

PAGE = Path(__file__).resolve().parent / "configuration.md"

HEAD = """\
# Configuration

<!-- Written by docs/reference/make_configuration.py; a test keeps it in step. -->

`mavins config --default > mavins.yaml` writes the file below; `mavins serve --config mavins.yaml` and
`mavins replay --config mavins.yaml` read it. A file needs only the keys that differ from their defaults:

```yaml
gnss:
  delay: 0.18
  lever_arm: [0.10, 0.0, -0.25]
streams:
  odometry: 0
```

An unknown key or a wrong value ends the command with one line that names its path and what is allowed there.
`mavins config --config mavins.yaml` checks a file and prints the effective configuration, which is also written
beside each result. Files follow YAML 1.2: `off` is a word and `1e-3` a number; a key written twice is an error.

Signs: a `delay` above zero means that the value was valid that long *before* its stamp. `imu.rotation` turns
the sensor's axes into the body's; `gnss.lever_arm` goes from the IMU to the antenna, forward, right, down.

## Every setting, with its default

"""


def page() -> str:
    """The whole page; the first line of the YAML, which names the version, is left out."""
    settings = default_yaml().partition("\n")[2].strip()
    return f"{HEAD}```yaml\n{settings}\n```\n"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
