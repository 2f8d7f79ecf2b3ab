"""What a log of ISO 11783-10 task data holds: its records, values, flow, and where the header is."""
