"""Who may do what in the pages: users, logins, roles, and the record of what was done."""
