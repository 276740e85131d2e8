"""What every experiment stands on: sessions, runners, reports, instances, planners and the exact oracle."""
