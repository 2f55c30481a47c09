"""HDF5: reading whatever programs have put there, and writing columns that every program reads."""
