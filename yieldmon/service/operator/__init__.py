"""What an operator asks and gets: requests, commands, answers, status."""
