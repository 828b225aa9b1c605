"""The application on the vehicle: from camera and track to velocity setpoints."""
