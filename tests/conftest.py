"""Keeps every test off the user's Hugging Face folders and off the network."""

import os
import tempfile

# Before LeRobot is imported: it reads these once.
os.environ["HF_HOME"] = tempfile.mkdtemp(prefix="pneutac_hf_")
os.environ["HF_HUB_OFFLINE"] = "1"
