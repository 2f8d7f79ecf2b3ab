"""The guided set-up: what is asked, what is made of the answers, and the files that come of them."""
