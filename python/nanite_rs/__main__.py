"""`python -m nanite_rs`."""

import sys

from nanite_rs.cli import main

sys.exit(main())
