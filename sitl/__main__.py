"""`python -m sitl`."""

import sys

from sitl.command import main

sys.exit(main())
