"""`python -m mavins` is `mavins`."""

import sys

from mavins.cli.main import main

sys.exit(main())
