"""Parts of the real robot behind small interfaces, and the limits that are kept below any policy."""
