"""The services as child processes of this command: started, watched, listened to, ended."""
