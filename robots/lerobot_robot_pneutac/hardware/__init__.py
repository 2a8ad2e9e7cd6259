"""Parts of the real robot behind small interfaces, and the limits that are enforced below any policy."""
