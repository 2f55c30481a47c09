"""Files of instruments: makers' headers, binary formats, and texts that are read as a whole."""
