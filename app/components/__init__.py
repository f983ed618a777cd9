"""Building blocks of the pages: they turn plain records into Dash components, and know no run and no callback."""
