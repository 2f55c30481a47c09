"""The use cases: a model over a signal, a compensation, a comparison, an identification, a live controller.

Blocks of samples go in and come out; what must be said of a run is returned as data.
"""

from __future__ import annotations
