def documentation_page(interface):
    return "<html></html>"
