"""Keeps every test off the user's Hugging Face folders and off the network."""

import os
import tempfile

# Before LeRobot is imported: it reads these once.
os.environ["HF_HOME"] = tempfile.mkdtemp(prefix="pneutac_hf_")
os.environ["HF_HUB_OFFLINE"] = "1"


def pytest_collection_modifyitems(items):
    """Files with slow tests begin first, so that at the end no process waits for another."""
    slow = {item.path for item in items if item.get_closest_marker("slow")}
    items.sort(key=lambda item: item.path not in slow)
