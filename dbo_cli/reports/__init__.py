"""What is only written: reports and figures."""
