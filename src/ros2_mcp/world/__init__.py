"""What is known of space and bodies: transforms, descriptions, footprints, costs, clouds and scans."""
