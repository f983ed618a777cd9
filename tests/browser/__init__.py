"""A package, so that what is opened for these tests is closed after the last of them."""
