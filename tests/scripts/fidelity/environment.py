"""The virtual environment of the scripts that measure surfaces. Uses nothing but Python's own library."""
import os
import subprocess
import sys
from pathlib import Path

REQUIREMENTS = Path(__file__).resolve().parents[1] / "fidelity-requirements.txt"
VENV = Path(__file__).resolve().parents[3] / "target" / "fidelity-venv"


def enter_environment(python=None):
    """Continues this program in `python`, or in an environment of its own that has the requirements."""
    if os.environ.get("ISOPEEL_FIDELITY"):
        return
    if python is None:
        python = VENV / "bin/python"
        stamp = VENV / "requirements.txt"
        wanted = REQUIREMENTS.read_text()
        if not stamp.exists() or stamp.read_text() != wanted:
            subprocess.run([sys.executable, "-m", "venv", VENV], check=True)
            subprocess.run([python, "-m", "pip", "install", "-q", "-r", REQUIREMENTS], check=True)
            stamp.write_text(wanted)
    os.execve(python, [str(python), *sys.argv], {**os.environ, "ISOPEEL_FIDELITY": "1"})
