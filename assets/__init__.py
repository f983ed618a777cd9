"""What ships beside the code: web/ (served by the dashboard), scenarios/, maps/, demos/, studies/."""

from importlib.resources import files
from pathlib import Path


def path(*parts: str) -> Path:
    """The file or folder assets/<parts…>, wherever the program is installed and whatever the working folder.

    It need not exist. Parts that lead out of assets/ raise ValueError.
    """
    root = Path(str(files(__name__))).resolve()
    found = root.joinpath(*parts).resolve()
    if not found.is_relative_to(root):
        raise ValueError(f"assets.path{parts}: leads out of the assets folder")
    return found
