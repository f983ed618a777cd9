"""The pages: layouts and callbacks. `shell.install` puts them all into a Dash app."""
