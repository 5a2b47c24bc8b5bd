"""What a report says: of one map, of two maps, of a sweep."""
