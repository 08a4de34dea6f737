"""A robot that learns on the table: each film changes what is believed of it, and the belief chooses the next
gait."""
