"""The use cases: a model over a signal, a compensation, a comparison, an identification, a live controller.

Blocks of samples go in and come out; the remarks of a run are returned as data.
"""

from __future__ import annotations
