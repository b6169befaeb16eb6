"""Site of the documentation: pages made from the code, diagrams, and what MkDocs needs to build it."""
