"""One YAML, one frozen tree: ``tree`` is its shape, ``load`` reads it and says what is wrong with it, and where."""
