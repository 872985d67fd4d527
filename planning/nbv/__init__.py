"""Where to look next: candidate views, their expected gain, the search over them, and the survey's views."""

import numba

# The default, TBB, warns and steps aside when a library beside us has brought an older one; OpenMP is always there.
numba.config.THREADING_LAYER = "omp"
