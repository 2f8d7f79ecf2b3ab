"""What operators enter: actions in order, what stands of tickets, and what is asked about one."""
