"""The virtual machines of tools/vcan-vm: a Debian kernel with this machine's own file system as its read-only root."""
