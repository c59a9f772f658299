"""Which files may be opened: permissions of the user, where names lead, and what files name others."""
