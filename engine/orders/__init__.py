"""Orders: the table of what is to be carried, and the sources that fill it."""
