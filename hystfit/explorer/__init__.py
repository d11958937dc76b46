"""A page in the browser that shows a model beside a measured loop, with a slider for each parameter."""
