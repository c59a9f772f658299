<?xml version="1.0" encoding="utf-8"?>
<!DOCTYPE TS>
<TS version="2.1" language="de" sourcelanguage="en">
  <context>
    <name>pcwlad_geo</name>
    <message>
      <source>Band-to-band QA</source>
      <translation>Passgenauigkeit von Kanälen prüfen</translation>
    </message>
    <message>
      <source>Measures how well the bands of several rasters, or of one, lie on each other: every pair, or each against one band. Nothing is corrected.
&lt;b&gt;Requirements&lt;/b&gt;: limits that every pair must meet, separated by semicolons, such as &lt;i&gt;CE90&amp;lt;=0.3px; closure&amp;lt;=0.05px&lt;/i&gt;. Statistics: mean, median, std, RMSE, LE90, CE90, CE95, closure; units: px, m. The output PASSED says whether all are met.
&lt;b&gt;Report&lt;/b&gt;: opens in the Results Viewer.</source>
      <translation>Misst, wie gut die Kanäle mehrerer Raster oder eines einzigen aufeinander liegen: jedes Paar, oder jeder gegen einen Kanal. Nichts wird korrigiert.
&lt;b&gt;Anforderungen&lt;/b&gt;: Grenzen, die jedes Paar einhalten muss, durch Semikolon getrennt, etwa &lt;i&gt;CE90&amp;lt;=0.3px; closure&amp;lt;=0.05px&lt;/i&gt;. Statistiken: mean, median, std, RMSE, LE90, CE90, CE95, closure; Einheiten: px, m. Die Ausgabe PASSED sagt, ob alle eingehalten sind.
&lt;b&gt;Bericht&lt;/b&gt;: öffnet sich in der Ergebnisanzeige.</translation>
    </message>
    <message>
      <source>HTML files (*.html)</source>
      <translation>HTML-Dateien (*.html)</translation>
    </message>
    <message>
      <source>CSV files (*.csv)</source>
      <translation>CSV-Dateien (*.csv)</translation>
    </message>
    <message>
      <source>All requirements are met.</source>
      <translation>Alle Anforderungen sind erfüllt.</translation>
    </message>
    <message>
      <source>Not all requirements are met.</source>
      <translation>Nicht alle Anforderungen sind erfüllt.</translation>
    </message>
    <message>
      <source>Refused: {}</source>
      <translation>Abgelehnt: {}</translation>
    </message>
    <message>
      <source>Registration</source>
      <translation>Registrierung</translation>
    </message>
    <message>
      <source>More options: QGIS loads files that --no-report leaves out. Leave that option out.</source>
      <translation>Weitere Optionen: QGIS lädt Dateien, die --no-report auslässt. Lassen Sie diese Option weg.</translation>
    </message>
    <message>
      <source>Matching window: its side must be odd, such as 81 or 129.</source>
      <translation>Vergleichsfenster: Die Seitenlänge muss ungerade sein, etwa 81 oder 129.</translation>
    </message>
    <message>
      <source>A requirement is not met, and nothing was corrected: {} (report: {})</source>
      <translation>Eine Anforderung ist nicht erfüllt, und nichts wurde korrigiert: {} (Bericht: {})</translation>
    </message>
    <message>
      <source>Starting the engine</source>
      <translation>Die Engine startet</translation>
    </message>
    <message>
      <source>More options: a quotation mark is not closed. Close it, or leave it out.</source>
      <translation>Weitere Optionen: ein Anführungszeichen ist nicht geschlossen. Schließen Sie es, oder lassen Sie es weg.</translation>
    </message>
    <message>
      <source>{}: the engine writes GeoTIFF. Choose a file name that ends in .tif.</source>
      <translation>{}: Die Engine schreibt GeoTIFF. Wählen Sie einen Dateinamen, der auf .tif endet.</translation>
    </message>
    <message>
      <source>the folder {} does not exist. Make it, or choose another.</source>
      <translation>Den Ordner {} gibt es nicht. Legen Sie ihn an, oder wählen Sie einen anderen.</translation>
    </message>
    <message>
      <source>{} cannot be written. Choose another place.</source>
      <translation>{} kann nicht geschrieben werden. Wählen Sie einen anderen Ort.</translation>
    </message>
    <message>
      <source>{} is a file. Choose a folder.</source>
      <translation>{} ist eine Datei. Wählen Sie einen Ordner.</translation>
    </message>
    <message>
      <source>{} is a folder. Choose a file.</source>
      <translation>{} ist ein Ordner. Wählen Sie eine Datei.</translation>
    </message>
    <message>
      <source>{}: {} is an input too. Choose another file.</source>
      <translation>{}: {} ist auch eine Eingabe. Wählen Sie eine andere Datei.</translation>
    </message>
    <message>
      <source>{}: {} is chosen for two outputs. Choose another file.</source>
      <translation>{}: {} ist für zwei Ausgaben gewählt. Wählen Sie eine andere Datei.</translation>
    </message>
    <message>
      <source>Engine: pcwlad-geo {}</source>
      <translation>Engine: pcwlad-geo {}</translation>
    </message>
    <message>
      <source>Engine</source>
      <translation>Engine</translation>
    </message>
    <message>
      <source>Check engine</source>
      <translation>Engine prüfen</translation>
    </message>
    <message>
      <source>Finds the engine that the other algorithms run, and says its version and whether it fits this plugin. It is looked for in Processing options (Providers, pcwlad-geo), in the environment variable PCWLAD_GEO_PYTHON, where “Install engine” puts it, and on PATH, in this order.</source>
      <translation>Sucht die Engine, die die anderen Algorithmen ausführen, und nennt ihre Version und ob sie zu dieser Erweiterung passt. Gesucht wird in den Optionen der Verarbeitung (Datenanbieter, pcwlad-geo), in der Umgebungsvariablen PCWLAD_GEO_PYTHON, dort, wo „Engine installieren“ sie ablegt, und im PATH, in dieser Reihenfolge.</translation>
    </message>
    <message>
      <source>Install engine</source>
      <translation>Engine installieren</translation>
    </message>
    <message>
      <source>Makes a virtual environment beside your QGIS profile and installs the engine there. QGIS and its own Python stay as they are.
It is downloaded by pip from the package index that is configured on this computer, unless you give its &lt;b&gt;wheel&lt;/b&gt; (pcwlad_geo-….whl) or its &lt;b&gt;source folder&lt;/b&gt;. So are the libraries it needs, through the proxy of QGIS's network options if there is one: about 280 MB, and about 1000 MB on the disk; some minutes.
&lt;b&gt;Without internet&lt;/b&gt;: on another computer of this kind run &lt;i&gt;pip download -d FOLDER WHEEL_OF_PCWLAD_GEO&lt;/i&gt;, and give FOLDER as &lt;b&gt;folder of wheels&lt;/b&gt;.
&lt;b&gt;Python&lt;/b&gt;: 3.10 or newer; found by itself in most cases. An engine installed earlier is replaced when the new one works.</source>
      <translation>Legt neben Ihrem QGIS-Profil eine virtuelle Umgebung an und installiert die Engine dort. QGIS und sein eigenes Python bleiben, wie sie sind.
pip lädt sie aus dem Paketverzeichnis, das auf diesem Rechner eingestellt ist, wenn Sie nicht ihr &lt;b&gt;Wheel&lt;/b&gt; (pcwlad_geo-….whl) oder ihren &lt;b&gt;Quellordner&lt;/b&gt; angeben. Ebenso die nötigen Bibliotheken, über den Proxy der Netzwerkoptionen von QGIS, wenn es einen gibt: etwa 280 MB, auf der Platte etwa 1000 MB; einige Minuten.
&lt;b&gt;Ohne Internet&lt;/b&gt;: Führen Sie auf einem anderen Rechner dieser Art &lt;i&gt;pip download -d FOLDER WHEEL_OF_PCWLAD_GEO&lt;/i&gt; aus, und geben Sie FOLDER als &lt;b&gt;Ordner mit Wheels&lt;/b&gt; an.
&lt;b&gt;Python&lt;/b&gt;: 3.10 oder neuer; wird meist von selbst gefunden. Eine früher installierte Engine wird ersetzt, sobald die neue läuft.</translation>
    </message>
    <message>
      <source>They do not fit: the engine has protocol {}, and the plugin needs {}.</source>
      <translation>Sie passen nicht zusammen: Die Engine hat das Protokoll {}, die Erweiterung braucht {}.</translation>
    </message>
    <message>
      <source>About {} MB will be downloaded, and {} MB be taken on the disk; some minutes.</source>
      <translation>Etwa {} MB werden heruntergeladen und {} MB auf der Platte belegt; einige Minuten.</translation>
    </message>
    <message>
      <source>They fit.</source>
      <translation>Sie passen zusammen.</translation>
    </message>
    <message>
      <source>All files (*)</source>
      <translation>Alle Dateien (*)</translation>
    </message>
    <message>
      <source>Engine: {} ({})</source>
      <translation>Engine: {} ({})</translation>
    </message>
    <message>
      <source>Its version: {}; this plugin: {}</source>
      <translation>Ihre Version: {}; diese Erweiterung: {}</translation>
    </message>
    <message>
      <source>Installed: pcwlad-geo {} in {}</source>
      <translation>Installiert: pcwlad-geo {} in {}</translation>
    </message>
    <message>
      <source>Register many rasters</source>
      <translation>Viele Raster registrieren</translation>
    </message>
    <message>
      <source>Registers many rasters (the targets) to one reference, one after another. A pair that is refused or cannot be used does not stop the rest.
&lt;h3&gt;Results&lt;/h3&gt;&lt;b&gt;Folder&lt;/b&gt;: a folder for each target, with its registered raster, tie points and report, and &lt;i&gt;summary.csv&lt;/i&gt;, a line a pair: status, accuracy, and the reason of a refusal. Run again with the same folder, pairs that are done are not done twice.</source>
      <translation>Registriert viele Raster (die Ziele) auf eine Referenz, eines nach dem anderen. Ein Paar, das abgelehnt wird oder nicht brauchbar ist, hält die übrigen nicht auf.
&lt;h3&gt;Ergebnisse&lt;/h3&gt;&lt;b&gt;Ordner&lt;/b&gt;: ein Ordner für jedes Ziel, mit seinem registrierten Raster, Verknüpfungspunkten und Bericht, und &lt;i&gt;summary.csv&lt;/i&gt;, eine Zeile je Paar: Status, Genauigkeit und der Grund einer Ablehnung. Mit demselben Ordner erneut ausgeführt, werden fertige Paare nicht noch einmal gerechnet.</translation>
    </message>
    <message>
      <source>{} of {} targets registered.</source>
      <translation>{} von {} Zielen registriert.</translation>
    </message>
    <message>
      <source>The reference is among the targets. Take it out.</source>
      <translation>Die Referenz ist unter den Zielen. Nehmen Sie sie heraus.</translation>
    </message>
    <message>
      <source>{}: {}</source>
      <translation>{}: {}</translation>
    </message>
    <message>
      <source>Match only</source>
      <translation>Nur zuordnen</translation>
    </message>
    <message>
      <source>Finds tie points between two rasters of the same ground and measures how far the target is displaced. Nothing is fitted or warped.
&lt;h3&gt;Results&lt;/h3&gt;&lt;b&gt;Tie points&lt;/b&gt;: a layer with an arrow for the displacement of each point, exaggerated as its legend says. The arrow points from where the target's georeferencing places the ground to where the target shows it.
&lt;b&gt;Report&lt;/b&gt;: opens in the Results Viewer.
&lt;b&gt;Points for the Georeferencer&lt;/b&gt;: loads by itself if it lies beside the target as &lt;i&gt;target.tif.points&lt;/i&gt;.</source>
      <translation>Findet Verknüpfungspunkte zwischen zwei Rastern desselben Geländes und misst, wie weit das Ziel verschoben ist. Nichts wird angepasst oder entzerrt.
&lt;h3&gt;Ergebnisse&lt;/h3&gt;&lt;b&gt;Verknüpfungspunkte&lt;/b&gt;: ein Layer mit einem Pfeil für die Verschiebung jedes Punktes, überhöht, wie die Legende sagt. Der Pfeil zeigt von dort, wohin die Georeferenzierung des Ziels das Gelände legt, dorthin, wo das Ziel es zeigt.
&lt;b&gt;Bericht&lt;/b&gt;: öffnet sich in der Ergebnisanzeige.
&lt;b&gt;Punkte für die Georeferenzierung&lt;/b&gt;: werden von selbst geladen, wenn sie neben dem Ziel als &lt;i&gt;target.tif.points&lt;/i&gt; liegen.</translation>
    </message>
    <message>
      <source>Prove a pair</source>
      <translation>Ein Paar prüfen</translation>
    </message>
    <message>
      <source>Measures the tool's own error on your pair, without a truth from elsewhere: the target is moved by known amounts, with fresh noise, and the same tie points are matched again. Nothing is corrected.
&lt;h3&gt;Results&lt;/h3&gt;&lt;b&gt;Errors of the matching&lt;/b&gt;: a layer of points, coloured by the error of one match in target pixels.
&lt;b&gt;Report&lt;/b&gt;: opens in the Results Viewer; bias, scatter, pixel locking, whether the sigmas hold, wrong matches that passed every test.
&lt;b&gt;Figures&lt;/b&gt;: proof.json, all of it for programs.
What the two bands show at different places by nature (shadows, warm walls) no proof sees; the report says how much has to be allowed for.</source>
      <translation>Misst den eigenen Fehler des Werkzeugs an Ihrem Paar, ohne eine Wahrheit von anderswo: Das Ziel wird um bekannte Beträge verschoben und bekommt frisches Rauschen, und dieselben Verknüpfungspunkte werden noch einmal zugeordnet. Nichts wird korrigiert.
&lt;h3&gt;Ergebnisse&lt;/h3&gt;&lt;b&gt;Fehler der Zuordnung&lt;/b&gt;: ein Punktlayer, gefärbt nach dem Fehler einer Zuordnung in Pixeln des Ziels.
&lt;b&gt;Bericht&lt;/b&gt;: öffnet sich in der Ergebnisanzeige; systematischer Fehler, Streuung, Neigung zu ganzen Pixeln, ob die Sigmas stimmen, falsche Zuordnungen, die jede Prüfung bestanden.
&lt;b&gt;Zahlen&lt;/b&gt;: proof.json, alles für Programme.
Was die beiden Kanäle von Natur aus an verschiedenen Stellen zeigen (Schatten, warme Wände), sieht keine solche Prüfung; der Bericht sagt, womit zu rechnen ist.</translation>
    </message>
    <message>
      <source>Shift layers by</source>
      <translation>Layer verschieben um</translation>
    </message>
    <message>
      <source>Moves many rasters and vectors by the same amount. Pixels and attributes stay as they are: a raster becomes a small file (VRT) that shows the same pixels elsewhere, a vector file a moved copy.
dx and dy are in the units of the CRS of the first layer; the rotation is about its middle, and before the shift.</source>
      <translation>Verschiebt viele Raster und Vektoren um denselben Betrag. Pixel und Attribute bleiben, wie sie sind: Ein Raster wird zu einer kleinen Datei (VRT), die dieselben Pixel anderswo zeigt, eine Vektordatei zu einer verschobenen Kopie.
dx und dy sind in den Einheiten des KBS des ersten Layers; gedreht wird um seine Mitte, vor der Verschiebung.</translation>
    </message>
    <message>
      <source>Apply registration to vectors</source>
      <translation>Registrierung auf Vektoren anwenden</translation>
    </message>
    <message>
      <source>Moves vector layers that were drawn on the target of a finished registration to where they belong. Attributes, CRS and heights stay; all layers of a file are moved.
&lt;b&gt;Registration&lt;/b&gt;: the folder that “Register raster” wrote as &lt;i&gt;Folder of all results&lt;/i&gt;.</source>
      <translation>Verschiebt Vektorlayer, die auf dem Ziel einer fertigen Registrierung gezeichnet wurden, dorthin, wo sie hingehören. Attribute, KBS und Höhen bleiben; alle Layer einer Datei werden verschoben.
&lt;b&gt;Registrierung&lt;/b&gt;: der Ordner, den „Raster registrieren“ als &lt;i&gt;Ordner aller Ergebnisse&lt;/i&gt; geschrieben hat.</translation>
    </message>
    <message>
      <source>Georeferencer points (*.points)</source>
      <translation>Punkte der Georeferenzierung (*.points)</translation>
    </message>
    <message>
      <source>Reference: choose a layer.</source>
      <translation>Referenz: einen Layer auswählen.</translation>
    </message>
    <message>
      <source>Reference and target are the same raster and band. Choose another target.</source>
      <translation>Referenz und Ziel sind dasselbe Raster und derselbe Kanal. Wählen Sie ein anderes Ziel.</translation>
    </message>
    <message>
      <source>The tie points cannot be written: {}</source>
      <translation>Die Verknüpfungspunkte können nicht geschrieben werden: {}</translation>
    </message>
    <message>
      <source>Extent: the layer has no place on the map. Leave the extent out.</source>
      <translation>Ausdehnung: Der Layer hat keinen Ort auf der Karte. Die Ausdehnung weglassen.</translation>
    </message>
    <message>
      <source>Extent: it lies outside of the reference. Choose another.</source>
      <translation>Ausdehnung: Sie liegt außerhalb der Referenz. Wählen Sie eine andere.</translation>
    </message>
    <message>
      <source>There are too few tie points for arrows along the axes of the map.</source>
      <translation>Es sind zu wenige Verknüpfungspunkte für Pfeile entlang der Achsen der Karte.</translation>
    </message>
    <message>
      <source>Register raster</source>
      <translation>Raster registrieren</translation>
    </message>
    <message>
      <source>Registers a raster (the target) to another of the same ground (the reference) to a fraction of a pixel. The two may come from different bands, sensors or dates, and differ in pixel size, extent and CRS.
&lt;h3&gt;Results&lt;/h3&gt;&lt;b&gt;Registered raster&lt;/b&gt;: the target, warped once onto the reference's pixel alignment.
&lt;b&gt;Tie points&lt;/b&gt;: a layer with an arrow for the residual of each point, exaggerated as its legend says. The arrow points from where the correction expects the ground to where the target shows it.
&lt;b&gt;Report&lt;/b&gt;: opens in the Results Viewer; says how well it fits, where not, and what to do.
&lt;b&gt;Points for the Georeferencer&lt;/b&gt;: loads by itself if it lies beside the target as &lt;i&gt;target.tif.points&lt;/i&gt;.
&lt;b&gt;Folder of all results&lt;/b&gt;: needed for “Apply registration”.
RMSE and CE90 are those of check points, which the correction has not seen, in target pixels. The quality (good, fair or poor) is that of all the ground that both show.
&lt;h3&gt;If the pair is refused&lt;/h3&gt;A pair is refused if its points agree no better than those of unrelated images would, or if they agree but the correction does not hold: there is no raster then, and the message says why and what to try. A displacement of more than 12 pixels needs a larger search radius.
&lt;h3&gt;Requirements&lt;/h3&gt;Limits on the figures, such as &lt;i&gt;CE90&amp;lt;=0.5px; points&amp;gt;=100&lt;/i&gt;. Where one is not met, the algorithm fails and there is no raster, unless it is to be kept.</source>
      <translation>Registriert ein Raster (das Ziel) auf Bruchteile eines Pixels auf ein anderes desselben Geländes (die Referenz). Die beiden dürfen aus verschiedenen Kanälen, von verschiedenen Sensoren oder Tagen stammen und sich in Pixelgröße, Ausdehnung und KBS unterscheiden.
&lt;h3&gt;Ergebnisse&lt;/h3&gt;&lt;b&gt;Registriertes Raster&lt;/b&gt;: das Ziel, einmal auf die Pixelausrichtung der Referenz umgerechnet.
&lt;b&gt;Verknüpfungspunkte&lt;/b&gt;: ein Layer mit einem Pfeil für den Restfehler jedes Punktes, überhöht, wie die Legende sagt. Der Pfeil zeigt von dort, wo die Korrektur das Gelände erwartet, dorthin, wo das Ziel es zeigt.
&lt;b&gt;Bericht&lt;/b&gt;: öffnet sich in der Ergebnisanzeige; sagt, wie gut es passt, wo nicht, und was zu tun ist.
&lt;b&gt;Punkte für die Georeferenzierung&lt;/b&gt;: werden von selbst geladen, wenn sie als &lt;i&gt;target.tif.points&lt;/i&gt; neben dem Ziel liegen.
&lt;b&gt;Ordner aller Ergebnisse&lt;/b&gt;: wird für „Registrierung anwenden“ gebraucht.
RMSE und CE90 sind die von Kontrollpunkten, die die Korrektur nicht gesehen hat, in Zielpixeln. Die Qualität (good: gut, fair: mäßig, poor: schlecht) ist die des ganzen Geländes, das beide zeigen.
&lt;h3&gt;Wenn das Paar abgelehnt wird&lt;/h3&gt;Ein Paar wird abgelehnt, wenn seine Punkte nicht besser übereinstimmen als die von Bildern, die nichts miteinander zu tun haben, oder wenn sie übereinstimmen, aber die Korrektur nicht trägt: dann gibt es kein Raster, und die Meldung sagt, warum und was zu versuchen ist. Eine Verschiebung um mehr als 12 Pixel braucht einen größeren Suchradius.
&lt;h3&gt;Anforderungen&lt;/h3&gt;Grenzen für die Kennzahlen, etwa &lt;i&gt;CE90&amp;lt;=0.5px; points&amp;gt;=100&lt;/i&gt;. Wird eine nicht erfüllt, scheitert der Algorithmus, und es gibt kein Raster, es sei denn, es soll behalten werden.</translation>
    </message>
    <message>
      <source>Apply registration</source>
      <translation>Registrierung anwenden</translation>
    </message>
    <message>
      <source>Applies the correction of a finished registration to another band of its target, of any pixel size. The raster is warped once, with all its bands; nothing is matched.
&lt;b&gt;Registration&lt;/b&gt;: the folder that “Register raster” wrote as &lt;i&gt;Folder of all results&lt;/i&gt;. Use the batch mode for many bands.</source>
      <translation>Wendet die Korrektur einer fertigen Registrierung auf einen anderen Kanal ihres Ziels an, bei beliebiger Pixelgröße. Das Raster wird einmal entzerrt, mit allen Kanälen; es wird nichts neu zugeordnet.
&lt;b&gt;Registrierung&lt;/b&gt;: der Ordner, den „Raster registrieren“ als &lt;i&gt;Ordner aller Ergebnisse&lt;/i&gt; geschrieben hat. Für viele Kanäle gibt es den Stapelmodus.</translation>
    </message>
    <message>
      <source>Align the bands of a drone camera</source>
      <translation>Kanäle einer Drohnenkamera ausrichten</translation>
    </message>
    <message>
      <source>Brings the lenses of a multispectral or thermal camera onto each other: one raster with all bands for each capture. Give a folder of raw frames; the rig is learned from them, or read from RIG.json.
&lt;h3&gt;Results&lt;/h3&gt;&lt;b&gt;Folder&lt;/b&gt;: the rasters, RIG.json, and a table that names bad captures and why.</source>
      <translation>Bringt die Objektive einer Multispektral- oder Wärmebildkamera aufeinander: je Aufnahme ein Raster mit allen Kanälen. Geben Sie einen Ordner mit Rohbildern an; die Anordnung der Objektive wird daraus gelernt oder aus RIG.json gelesen.
&lt;h3&gt;Ergebnisse&lt;/h3&gt;&lt;b&gt;Ordner&lt;/b&gt;: die Raster, RIG.json und eine Tabelle, die schlechte Aufnahmen mit dem Grund nennt.</translation>
    </message>
    <message>
      <source>Adjust a stack</source>
      <translation>Stapel ausgleichen</translation>
    </message>
    <message>
      <source>Brings many rasters of one ground into one frame, all together: pairs are matched, one adjustment gives every raster a correction, and pairs that contradict the others are left out. Raw images with RPCs need a DEM: their RPCs are corrected, and they are orthorectified on one grid.
&lt;h3&gt;Results&lt;/h3&gt;&lt;b&gt;Folder&lt;/b&gt;: each raster on the grid of the reference, a table and a page with the sigma of each. Run again with the same folder, pairs that are done are not done twice.
&lt;b&gt;Report&lt;/b&gt;: opens in the Results Viewer.</source>
      <translation>Bringt viele Raster desselben Geländes gemeinsam in einen Rahmen: Paare werden zugeordnet, eine Ausgleichung gibt jedem Raster eine Korrektur, und Paare, die den übrigen widersprechen, bleiben außer Acht. Rohe Bilder mit RPC brauchen ein DGM: Ihre RPC werden korrigiert und sie selbst auf einem Gitter entzerrt.
&lt;h3&gt;Ergebnisse&lt;/h3&gt;&lt;b&gt;Ordner&lt;/b&gt;: jedes Raster auf dem Gitter der Referenz, eine Tabelle und eine Seite mit dem Sigma eines jeden. Mit demselben Ordner erneut ausgeführt, werden fertige Paare nicht noch einmal gerechnet.
&lt;b&gt;Bericht&lt;/b&gt;: öffnet sich in der Ergebnisanzeige.</translation>
    </message>
    <message>
      <source>Watch a stack</source>
      <translation>Einen Stapel überwachen</translation>
    </message>
    <message>
      <source>Tells what the dated rasters of a finished stack do over time: steps, drifts and seasons of each satellite, dates that lie off, and ground that moves by itself.
&lt;b&gt;Stack&lt;/b&gt;: the folder that “Adjust a stack” wrote; a series needs eight dates.
&lt;b&gt;Requirements&lt;/b&gt;: limits, separated by semicolons, such as &lt;i&gt;step&amp;lt;0.2px; latest&amp;lt;1px; motion&amp;lt;1px&lt;/i&gt;. Statistics: step, drift, season, latest, offset, motion; units: px, m. The output PASSED says whether all are met; all results are there where they are not.
&lt;h3&gt;Results&lt;/h3&gt;&lt;b&gt;Report&lt;/b&gt;: opens in the Results Viewer.
&lt;b&gt;Motion of the ground&lt;/b&gt;: a raster of the velocity (x, y, sigma; units of the CRS a year) and the number of the moving part, which is coloured.
&lt;b&gt;Table&lt;/b&gt;: a line a raster, with what its series lets expect.</source>
      <translation>Sagt, was die datierten Raster eines fertigen Stapels über die Zeit tun: Sprünge, Driften und Jahresgänge jedes Satelliten, Tage, die danebenliegen, und Gelände, das sich für sich bewegt.
&lt;b&gt;Stapel&lt;/b&gt;: der Ordner, den „Stapel ausgleichen“ geschrieben hat; eine Reihe braucht acht Tage.
&lt;b&gt;Anforderungen&lt;/b&gt;: Grenzen, durch Semikolon getrennt, etwa &lt;i&gt;step&amp;lt;0.2px; latest&amp;lt;1px; motion&amp;lt;1px&lt;/i&gt;. Größen: step, drift, season, latest, offset, motion; Einheiten: px, m. Die Ausgabe PASSED sagt, ob alle eingehalten sind; alle Ergebnisse sind da, auch wo sie es nicht sind.
&lt;h3&gt;Ergebnisse&lt;/h3&gt;&lt;b&gt;Bericht&lt;/b&gt;: öffnet sich in der Ergebnisanzeige.
&lt;b&gt;Bewegung des Geländes&lt;/b&gt;: ein Raster der Geschwindigkeit (x, y, Sigma; Einheiten des KBS im Jahr) und der Nummer des bewegten Teils, der gefärbt ist.
&lt;b&gt;Tabelle&lt;/b&gt;: eine Zeile je Raster, mit dem, was seine Reihe erwarten lässt.</translation>
    </message>
    <message>
      <source>not known</source>
      <translation>nicht bekannt</translation>
    </message>
    <message>
      <source>Dates: {} is no date. Write it as 2024-05-01.</source>
      <translation>Daten: {} ist kein Datum. So schreiben: 2024-05-01.</translation>
    </message>
    <message>
      <source>Dates: {} are given for {} rasters. Give one of each.</source>
      <translation>Daten: {} sind angegeben für {} Raster. Je Raster eines angeben.</translation>
    </message>
    <message>
      <source>Cannot be read: {}</source>
      <translation>Nicht lesbar: {}</translation>
    </message>
    <message>
      <source>{} (arrows × {})</source>
      <translation>{} (Pfeile × {})</translation>
    </message>
    <message>
      <source>{target} on {reference}: {n} points, mean {mean_col_px} px to the right, {mean_row_px} px down; CE90 {ce90_px} px</source>
      <translation>{target} auf {reference}: {n} Punkte, im Mittel {mean_col_px} px nach rechts, {mean_row_px} px nach unten; CE90 {ce90_px} px</translation>
    </message>
    <message>
      <source>Bias: {BIAS_COL:+.3f} px to the right, {BIAS_ROW:+.3f} px down. A tie point errs by RMSE {RMSE:.3f} px, CE90 {CE90:.3f} px; wrong matches that passed every test: {FALSE_MATCHES}</source>
      <translation>Systematischer Fehler: {BIAS_COL:+.3f} px nach rechts, {BIAS_ROW:+.3f} px nach unten. Fehler eines Verknüpfungspunkts: RMSE {RMSE:.3f} px, CE90 {CE90:.3f} px; falsche Zuordnungen, die jede Prüfung bestanden: {FALSE_MATCHES}</translation>
    </message>
    <message>
      <source>Series: {series}; steps: {steps}; parts of the ground that move: {moving}</source>
      <translation>Reihen: {series}; Sprünge: {steps}; Teile des Geländes, die sich bewegen: {moving}</translation>
    </message>
    <message>
      <source>{} of {} points are refined by matching. The others contradict {}: those are selected.</source>
      <translation>{} von {} Punkten sind durch Matching verfeinert. {} widersprechen den anderen: Sie sind ausgewählt.</translation>
    </message>
    <message>
      <source>Drag moves the layer, Ctrl-drag turns it, Alt-wheel scales it, arrow keys step, Ctrl-Z takes back.</source>
      <translation>Ziehen verschiebt den Layer, Strg+Ziehen dreht, Alt+Mausrad skaliert, Pfeiltasten gehen schrittweise, Strg+Z macht rückgängig.</translation>
    </message>
    <message>
      <source>Click a place of the layer, then where it belongs; up to three times.</source>
      <translation>Klicken Sie eine Stelle des Layers an, dann wohin sie gehört; bis zu dreimal.</translation>
    </message>
    <message>
      <source>The package index has no pcwlad-geo: choose “From a wheel…” or “From a folder…”.</source>
      <translation>Der Paketindex hat pcwlad-geo nicht: „Aus einem Wheel…“ oder „Aus einem Ordner…“ wählen.</translation>
    </message>
    <message>
      <source>{}: files of this kind can name other files. QGIS has opened it; the engine does so once you trust it.</source>
      <translation>{}: Dateien dieser Art können andere Dateien nennen. QGIS hat sie geöffnet; die Engine tut es, sobald Sie ihnen vertrauen.</translation>
    </message>
    <message>
      <source>No pcwlad-geo engine was found.</source>
      <translation>Keine pcwlad-geo-Engine gefunden.</translation>
    </message>
    <message>
      <source>Install one by “Install engine”, in the dock or the Processing toolbox. One that is somewhere else: name it in Processing options, Providers, pcwlad-geo.</source>
      <translation>Installieren Sie eine mit „Engine installieren“, im Dock oder in der Werkzeugkiste. Eine, die woanders liegt: nennen Sie sie in den Verarbeitungsoptionen unter Datenanbieter, pcwlad-geo.</translation>
    </message>
    <message>
      <source>The engine {} has version {} (protocol {}), this plugin is {} and needs protocol {}.</source>
      <translation>Die Engine {} hat Version {} (Protokoll {}), dieses Plugin ist {} und braucht Protokoll {}.</translation>
    </message>
    <message>
      <source>What the map shows</source>
      <translation>Was die Karte zeigt</translation>
    </message>
    <message>
      <source>The layer “{}” is no raster file (it comes from the provider “{}”). Save it first: right-click the layer, Export, Save As…, and use the file.</source>
      <translation>Der Layer „{}“ ist keine Rasterdatei (er kommt vom Datenanbieter „{}“). Speichern Sie ihn zuerst: Rechtsklick auf den Layer, Export, Speichern als…, und nehmen Sie die Datei.</translation>
    </message>
    <message>
      <source>The layer “{}” is opened with options ({}) that the engine cannot use. Save it as a file first.</source>
      <translation>Der Layer „{}“ ist mit Optionen geöffnet ({}), die die Engine nicht benutzen kann. Speichern Sie ihn erst als Datei.</translation>
    </message>
    <message>
      <source>The layer “{}” shows a part of its file (filter {}). Remove the filter, or save it as a file.</source>
      <translation>Der Layer „{}“ zeigt einen Teil seiner Datei (Filter {}). Entfernen Sie den Filter, oder speichern Sie ihn als Datei.</translation>
    </message>
    <message>
      <source>The layer “{}” is no file as QGIS shows it: it has unsaved edits, a filter, or another CRS, or is of a database. Save it as a file first.</source>
      <translation>Der Layer „{}“ ist keine Datei, wie QGIS ihn zeigt: Er hat ungespeicherte Änderungen, einen Filter oder ein anderes KBS, oder kommt aus einer Datenbank. Speichern Sie ihn zuerst als Datei.</translation>
    </message>
    <message>
      <source>Only georeferencing takes the models shift and affine: choose one of them, or automatic.</source>
      <translation>Nur georeferenzieren lassen sich die Modelle Verschiebung und affin: Wählen Sie eines davon, oder automatisch.</translation>
    </message>
    <message>
      <source>The {} names another engine, {}, which goes before this one: clear it to use this one.</source>
      <translation>„{}“ nennt eine andere Engine, {}, die dieser vorgeht: Löschen Sie den Eintrag, um diese zu benutzen.</translation>
    </message>
    <message>
      <source>No match within the radius: the point is where you have clicked, and counts as less certain.</source>
      <translation>Keine Übereinstimmung im Umkreis: Der Punkt liegt, wo Sie geklickt haben, und zählt als weniger sicher.</translation>
    </message>
    <message>
      <source>Other rasters that are aligned with the same reference, one after the other.</source>
      <translation>Weitere Raster, die nacheinander an derselben Referenz ausgerichtet werden.</translation>
    </message>
    <message>
      <source>Vector layers that were drawn on the layer as it was. They are moved as its pixels were.</source>
      <translation>Vektorlayer, die auf dem unkorrigierten Layer gezeichnet wurden. Sie werden wie seine Pixel verschoben.</translation>
    </message>
    <message>
      <source>Rasters of the same pixels' place as the layer, such as its other bands, of any pixel size.</source>
      <translation>Raster, deren Pixel liegen wie die des Layers, etwa seine anderen Kanäle; die Pixelgröße ist beliebig.</translation>
    </message>
    <message>
      <source>The raster whose place is right. It stays as it is.</source>
      <translation>Das Raster, dessen Lage richtig ist. Es bleibt, wie es ist.</translation>
    </message>
    <message>
      <source>QGIS draws these layers, and the target is registered onto the picture.</source>
      <translation>QGIS zeichnet diese Layer, und das Ziel wird auf das Bild eingepasst.</translation>
    </message>
    <message>
      <source>The band of the reference that is compared.</source>
      <translation>Der Kanal der Referenz, der verglichen wird.</translation>
    </message>
    <message>
      <source>The raster that is moved onto the reference.</source>
      <translation>Das Raster, das auf die Referenz bewegt wird.</translation>
    </message>
    <message>
      <source>The band of the target that is compared. All bands are corrected.</source>
      <translation>Der Kanal des Ziels, der verglichen wird. Korrigiert werden alle Kanäle.</translation>
    </message>
    <message>
      <source>Only this part of the two rasters is read, compared and written.</source>
      <translation>Nur dieser Teil der beiden Raster wird gelesen, verglichen und geschrieben.</translation>
    </message>
    <message>
      <source>Tie points are sought inside these polygons only.</source>
      <translation>Verknüpfungspunkte werden nur in diesen Polygonen gesucht.</translation>
    </message>
    <message>
      <source>No tie points are sought inside these polygons, such as clouds, water or forest.</source>
      <translation>In diesen Polygonen werden keine Verknüpfungspunkte gesucht, etwa Wolken, Wasser oder Wald.</translation>
    </message>
    <message>
      <source>Excludes pixels of the reference: those where this raster is 0. QA_PIXEL, SCL and MSK_CLASSI rasters are understood.</source>
      <translation>Schließt Pixel der Referenz aus: die, wo dieses Raster 0 ist. Raster QA_PIXEL, SCL und MSK_CLASSI werden verstanden.</translation>
    </message>
    <message>
      <source>Excludes pixels of the target: those where this raster is 0.</source>
      <translation>Schließt Pixel des Ziels aus: die, wo dieses Raster 0 ist.</translation>
    </message>
    <message>
      <source>Heights of the ground, for images with rational polynomial coefficients (RPC).</source>
      <translation>Geländehöhen, für Bilder mit rationalen Polynomkoeffizienten (RPC).</translation>
    </message>
    <message>
      <source>What is added to the heights to count from the ellipsoid, where the CRS of the DEM does not tell: metres, or the path of a geoid grid. 0: they count from the ellipsoid.</source>
      <translation>Was zu den Höhen kommt, damit sie vom Ellipsoid zählen, wo das KBS des DGM es nicht sagt: Meter oder der Pfad eines Geoidgitters. 0: Sie zählen vom Ellipsoid.</translation>
    </message>
    <message>
      <source>90 % of the check points must lie within so many pixels. Otherwise no raster is written.</source>
      <translation>90 % der Kontrollpunkte müssen in so vielen Pixeln liegen. Sonst wird kein Raster geschrieben.</translation>
    </message>
    <message>
      <source>Limits on the figures, such as CE90&lt;=0.5px; points&gt;=100. Where one is not met, no raster is written.</source>
      <translation>Grenzen für die Zahlen, etwa CE90&lt;=0.5px; points&gt;=100. Wo eine nicht eingehalten ist, wird kein Raster geschrieben.</translation>
    </message>
    <message>
      <source>Limits that every pair must meet, such as CE90&lt;=0.3px; closure&lt;=0.05px.</source>
      <translation>Grenzen, die jedes Paar einhalten muss, etwa CE90&lt;=0.3px; closure&lt;=0.05px.</translation>
    </message>
    <message>
      <source>Limits on the largest of any series or part, such as step&lt;0.2px; motion&lt;1px.</source>
      <translation>Grenzen für das Größte aller Reihen oder Teile, etwa step&lt;0.2px; motion&lt;1px.</translation>
    </message>
    <message>
      <source>How the displacement may change over the image. Automatic takes the simplest model that predicts points left out as well as any other.</source>
      <translation>Wie sich die Verschiebung über das Bild ändern darf. Automatisch nimmt das einfachste Modell, das weggelassene Punkte so gut vorhersagt wie jedes andere.</translation>
    </message>
    <message>
      <source>The pixels stay as they are; a small file shows them at the right place. For shifts and affine corrections.</source>
      <translation>Die Pixel bleiben, wie sie sind; eine kleine Datei zeigt sie am richtigen Ort. Für Verschiebungen und affine Korrekturen.</translation>
    </message>
    <message>
      <source>The registered raster gets exactly the CRS, pixels and size of this one.</source>
      <translation>Das registrierte Raster bekommt genau das KBS, die Pixel und die Größe dieses Rasters.</translation>
    </message>
    <message>
      <source>How pixels are interpolated. Nearest neighbour for classes, Lanczos for everything else.</source>
      <translation>Wie Pixel interpoliert werden. Nächster Nachbar für Klassen, Lanczos für alles andere.</translation>
    </message>
    <message>
      <source>Fits the points of this file and matches nothing: tiepoints.csv, QGIS points, ENVI points.</source>
      <translation>Passt die Punkte dieser Datei an und ordnet nichts zu: tiepoints.csv, Punkte von QGIS oder ENVI.</translation>
    </message>
    <message>
      <source>Six numbers with commas: the GDAL geotransform in the CRS of the reference that the target gets instead of its own.</source>
      <translation>Sechs Zahlen mit Kommas: die GDAL-Geotransformation im KBS der Referenz, die das Ziel statt seiner eigenen bekommt.</translation>
    </message>
    <message>
      <source>Write the raster although a requirement is not met; the output PASSED says so.</source>
      <translation>Das Raster auch dann schreiben, wenn eine Anforderung nicht erfüllt ist; die Ausgabe PASSED sagt es.</translation>
    </message>
    <message>
      <source>How two windows are compared. The first is the most precise.</source>
      <translation>Wie zwei Fenster verglichen werden. Das erste Verfahren ist das genaueste.</translation>
    </message>
    <message>
      <source>At most so many, spread evenly, the most precise of each neighbourhood. Not set: 1000 of a scene, all of a small image.</source>
      <translation>Höchstens so viele, gleichmäßig verteilt, die genauesten jeder Umgebung. Leer: 1000 einer Szene, alle eines kleinen Bildes.</translation>
    </message>
    <message>
      <source>The largest displacement, pixels of the coarser raster. Raise it where that may exceed 12 pixels.</source>
      <translation>Die größte Verschiebung in Pixeln des gröberen Rasters. Erhöhen, wo sie 12 Pixel übersteigen kann.</translation>
    </message>
    <message>
      <source>Its side, odd, pixels of the coarser raster. Larger windows are more precise, smaller ones follow finer displacements.</source>
      <translation>Seitenlänge, ungerade, in Pixeln des gröberen Rasters. Größere Fenster sind genauer, kleinere folgen feineren Verschiebungen.</translation>
    </message>
    <message>
      <source>Automatic believes the georeferencing, and searches the whole image where that fails.</source>
      <translation>Automatisch glaubt der Georeferenzierung, und sucht das ganze Bild ab, wo sie nicht stimmt.</translation>
    </message>
    <message>
      <source>Number of processes that share a large scene. The result does not depend on it.</source>
      <translation>Zahl der Prozesse, die sich eine große Szene teilen. Das Ergebnis hängt nicht davon ab.</translation>
    </message>
    <message>
      <source>Any other option of the command line, as written there.</source>
      <translation>Jede andere Option der Kommandozeile, geschrieben wie dort.</translation>
    </message>
    <message>
      <source>The target, warped once from its original pixels. A GeoTIFF.</source>
      <translation>Das Ziel, einmal aus seinen ursprünglichen Pixeln entzerrt. Ein GeoTIFF.</translation>
    </message>
    <message>
      <source>A raster of the displacement in metres east and north, its sigma and its quality.</source>
      <translation>Ein Raster der Verschiebung in Metern nach Osten und Norden, mit Sigma und Qualität.</translation>
    </message>
    <message>
      <source>A layer of points, with an arrow for what is left at each, exaggerated.</source>
      <translation>Ein Punktlayer, mit einem überhöhten Pfeil für das, was an jedem Punkt übrig bleibt.</translation>
    </message>
    <message>
      <source>A page that says how well the two fit, where not, and what to do.</source>
      <translation>Eine Seite, die sagt, wie gut die beiden passen, wo nicht, und was zu tun ist.</translation>
    </message>
    <message>
      <source>Saved beside the target as &lt;target&gt;.points, the Georeferencer loads it by itself.</source>
      <translation>Neben dem Ziel als &lt;target&gt;.points gespeichert, lädt die Georeferenzierung sie von selbst.</translation>
    </message>
    <message>
      <source>Keeps all files of the job. “Apply registration” and the editor need it.</source>
      <translation>Behält alle Dateien des Auftrags. „Registrierung anwenden“ und der Editor brauchen ihn.</translation>
    </message>
    <message>
      <source>The figures as a table.</source>
      <translation>Die Zahlen als Tabelle.</translation>
    </message>
    <message>
      <source>The folder that “Register raster” wrote as “Folder of all results”.</source>
      <translation>Der Ordner, den „Raster registrieren“ als „Ordner aller Ergebnisse“ geschrieben hat.</translation>
    </message>
    <message>
      <source>Rasters of the same ground.</source>
      <translation>Raster desselben Geländes.</translation>
    </message>
    <message>
      <source>Rasters in one CRS, and vector layers in any.</source>
      <translation>Raster in einem KBS, und Vektorlayer in beliebigen.</translation>
    </message>
    <message>
      <source>Layers that were drawn on the target as it was.</source>
      <translation>Layer, die auf dem unkorrigierten Ziel gezeichnet wurden.</translation>
    </message>
    <message>
      <source>In the units of the CRS of the first layer, to the right.</source>
      <translation>In den Einheiten des KBS des ersten Layers, nach rechts.</translation>
    </message>
    <message>
      <source>In the units of the CRS of the first layer, up.</source>
      <translation>In den Einheiten des KBS des ersten Layers, nach oben.</translation>
    </message>
    <message>
      <source>Counter-clockwise, about the middle of the first layer, before the shift.</source>
      <translation>Gegen den Uhrzeigersinn, um die Mitte des ersten Layers, vor der Verschiebung.</translation>
    </message>
    <message>
      <source>From where the layers belong to where the uncorrected target draws them.</source>
      <translation>Von dort, wo die Layer hingehören, dorthin, wo das unkorrigierte Ziel sie zeigt.</translation>
    </message>
    <message>
      <source>Raw frames as the camera wrote them, one file a lens, of captures in flight.</source>
      <translation>Rohbilder, wie die Kamera sie schrieb, eine Datei je Objektiv, von Aufnahmen im Flug.</translation>
    </message>
    <message>
      <source>What an earlier run has learned of this camera. Not set: it is learned from the frames.</source>
      <translation>Was ein früherer Lauf über diese Kamera gelernt hat. Ohne Angabe wird es aus den Bildern gelernt.</translation>
    </message>
    <message>
      <source>The bands that are compared. Not set: all.</source>
      <translation>Die Kanäle, die verglichen werden. Leer: alle.</translation>
    </message>
    <message>
      <source>Compares every band with this one instead of each with each: the end of its name, such as B4.</source>
      <translation>Vergleicht jeden Kanal mit diesem statt jeden mit jedem: das Ende seines Namens, etwa B4.</translation>
    </message>
    <message>
      <source>The registration that a mission promises.</source>
      <translation>Die Passgenauigkeit, die eine Mission verspricht.</translation>
    </message>
    <message>
      <source>Excludes pixels of all rasters: those where this one is 0.</source>
      <translation>Schließt Pixel aller Raster aus: die, wo dieses 0 ist.</translation>
    </message>
    <message>
      <source>The raster whose grid all others get.</source>
      <translation>Das Raster, dessen Gitter alle anderen bekommen.</translation>
    </message>
    <message>
      <source>The raster whose grid all others get: the name of its file without extension.</source>
      <translation>Das Raster, dessen Gitter alle anderen bekommen: der Name seiner Datei ohne Endung.</translation>
    </message>
    <message>
      <source>One of each raster, in their order, separated by semicolons, such as 2024-05-01; 2024-06-02. Needed for “Watch a stack”. Not set: the time of a layer (Properties, Temporal), or the date in the name of its file (2024-05-01 or 20240501).</source>
      <translation>Eines je Raster, in ihrer Reihenfolge, durch Semikolons getrennt, etwa 2024-05-01; 2024-06-02. Nötig für „Einen Stapel überwachen“. Leer: die Zeit eines Layers (Eigenschaften, Zeitlich) oder das Datum im Namen seiner Datei (2024-05-01 oder 20240501).</translation>
    </message>
    <message>
      <source>One raster, which does not move; or the mean of all, if none is better than the others.</source>
      <translation>Ein Raster, das sich nicht bewegt; oder das Mittel aller, wenn keines besser ist als die anderen.</translation>
    </message>
    <message>
      <source>The band of each raster that is compared.</source>
      <translation>Der Kanal jedes Rasters, der verglichen wird.</translation>
    </message>
    <message>
      <source>Fewer pairs are quicker, and less is checked.</source>
      <translation>Weniger Paare gehen schneller, und weniger wird geprüft.</translation>
    </message>
    <message>
      <source>Full takes more points, and makes a part of the pair harder until it is refused: a minute or more.</source>
      <translation>Vollständig nimmt mehr Punkte und erschwert einen Teil des Paars, bis er abgelehnt wird: eine Minute oder mehr.</translation>
    </message>
    <message>
      <source>The folder that “Adjust a stack” wrote.</source>
      <translation>Der Ordner, den „Stapel ausgleichen“ geschrieben hat.</translation>
    </message>
    <message>
      <source>A layer of points, coloured by the error of one match, in target pixels.</source>
      <translation>Ein Punktlayer, gefärbt nach dem Fehler einer Zuordnung, in Pixeln des Ziels.</translation>
    </message>
    <message>
      <source>A raster of the velocity of the ground and the parts that move by themselves.</source>
      <translation>Ein Raster der Geschwindigkeit des Geländes und der Teile, die sich für sich bewegen.</translation>
    </message>
    <message>
      <source>The file pcwlad_geo-….whl. Not set: the package index has it.</source>
      <translation>Die Datei pcwlad_geo-….whl. Nicht gesetzt: aus dem Paketverzeichnis.</translation>
    </message>
    <message>
      <source>The folder with pyproject.toml.</source>
      <translation>Der Ordner mit pyproject.toml.</translation>
    </message>
    <message>
      <source>A folder filled by “pip download” on a computer with internet; nothing is downloaded then.</source>
      <translation>Ein Ordner, den „pip download“ auf einem Rechner mit Internet gefüllt hat; dann wird nichts heruntergeladen.</translation>
    </message>
    <message>
      <source>The program python3 or python.exe. That of QGIS is taken if it is new enough.</source>
      <translation>Das Programm python3 oder python.exe. Das von QGIS wird genommen, wenn es neu genug ist.</translation>
    </message>
    <message>
      <source>Reference (stays)</source>
      <translation>Referenz (bleibt)</translation>
    </message>
    <message>
      <source>Band of the reference</source>
      <translation>Kanal der Referenz</translation>
    </message>
    <message>
      <source>Layers to draw as the reference</source>
      <translation>Layer, die als Referenz gezeichnet werden</translation>
    </message>
    <message>
      <source>Target (moves)</source>
      <translation>Ziel (bewegt sich)</translation>
    </message>
    <message>
      <source>Another band of the target</source>
      <translation>Anderer Kanal des Ziels</translation>
    </message>
    <message>
      <source>Band of the target</source>
      <translation>Kanal des Ziels</translation>
    </message>
    <message>
      <source>Extent (not set: all)</source>
      <translation>Ausdehnung (leer: alles)</translation>
    </message>
    <message>
      <source>Area of interest</source>
      <translation>Untersuchungsgebiet</translation>
    </message>
    <message>
      <source>Excluded area</source>
      <translation>Ausgeschlossenes Gebiet</translation>
    </message>
    <message>
      <source>Mask of the reference (0 = excluded)</source>
      <translation>Maske der Referenz (0 = ausgeschlossen)</translation>
    </message>
    <message>
      <source>Mask of the target (0 = excluded)</source>
      <translation>Maske des Ziels (0 = ausgeschlossen)</translation>
    </message>
    <message>
      <source>DEM, for a target with RPCs</source>
      <translation>DGM, für ein Ziel mit RPC</translation>
    </message>
    <message>
      <source>DEM, for images with RPCs</source>
      <translation>DGM, für Bilder mit RPC</translation>
    </message>
    <message>
      <source>DEM: what is added to its heights</source>
      <translation>DGM: was zu seinen Höhen addiert wird</translation>
    </message>
    <message>
      <source>Required accuracy: CE90, target pixels</source>
      <translation>Geforderte Genauigkeit: CE90, Zielpixel</translation>
    </message>
    <message>
      <source>Requirements, separated by semicolons</source>
      <translation>Anforderungen, durch Semikolon getrennt</translation>
    </message>
    <message>
      <source>Correction model</source>
      <translation>Korrekturmodell</translation>
    </message>
    <message>
      <source>Only georeference (a VRT, no registered raster)</source>
      <translation>Nur georeferenzieren (ein VRT, kein Raster)</translation>
    </message>
    <message>
      <source>Grid of another raster</source>
      <translation>Gitter eines anderen Rasters</translation>
    </message>
    <message>
      <source>Resampling</source>
      <translation>Resampling</translation>
    </message>
    <message>
      <source>Tie points of a file</source>
      <translation>Verknüpfungspunkte einer Datei</translation>
    </message>
    <message>
      <source>Geotransform of the target, put by hand</source>
      <translation>Geotransformation des Ziels, von Hand gelegt</translation>
    </message>
    <message>
      <source>Keep the raster although a requirement is not met</source>
      <translation>Raster trotz verfehlter Anforderung behalten</translation>
    </message>
    <message>
      <source>Matching method</source>
      <translation>Verfahren der Zuordnung</translation>
    </message>
    <message>
      <source>Tie points wanted (0: all; not set: automatic)</source>
      <translation>Gewünschte Punkte (0: alle; leer: automatisch)</translation>
    </message>
    <message>
      <source>Search radius, pixels (not set: automatic)</source>
      <translation>Suchradius, Pixel (leer: automatisch)</translation>
    </message>
    <message>
      <source>Matching window, pixels (not set: automatic)</source>
      <translation>Vergleichsfenster, Pixel (leer: automatisch)</translation>
    </message>
    <message>
      <source>Rough alignment</source>
      <translation>Grobe Ausrichtung</translation>
    </message>
    <message>
      <source>Processes (not set: one a core)</source>
      <translation>Prozesse (leer: einer je Kern)</translation>
    </message>
    <message>
      <source>More options, such as --features 500</source>
      <translation>Weitere Optionen, etwa --features 500</translation>
    </message>
    <message>
      <source>Registered raster</source>
      <translation>Registriertes Raster</translation>
    </message>
    <message>
      <source>Displacement field</source>
      <translation>Verschiebungsfeld</translation>
    </message>
    <message>
      <source>Tie points</source>
      <translation>Verknüpfungspunkte</translation>
    </message>
    <message>
      <source>Report</source>
      <translation>Bericht</translation>
    </message>
    <message>
      <source>Points for the Georeferencer</source>
      <translation>Punkte für die Georeferenzierung</translation>
    </message>
    <message>
      <source>Folder of all results</source>
      <translation>Ordner aller Ergebnisse</translation>
    </message>
    <message>
      <source>Table, a line a pair</source>
      <translation>Tabelle, eine Zeile je Paar</translation>
    </message>
    <message>
      <source>Table, a line a raster</source>
      <translation>Tabelle, eine Zeile je Raster</translation>
    </message>
    <message>
      <source>Table, a line a capture</source>
      <translation>Tabelle, eine Zeile je Aufnahme</translation>
    </message>
    <message>
      <source>Figures (JSON)</source>
      <translation>Zahlen (JSON)</translation>
    </message>
    <message>
      <source>Errors of the matching</source>
      <translation>Fehler der Zuordnung</translation>
    </message>
    <message>
      <source>Motion of the ground</source>
      <translation>Bewegung des Geländes</translation>
    </message>
    <message>
      <source>Effort</source>
      <translation>Aufwand</translation>
    </message>
    <message>
      <source>Stack (folder of all results)</source>
      <translation>Stapel (Ordner aller Ergebnisse)</translation>
    </message>
    <message>
      <source>More options, such as --add image.tif</source>
      <translation>Weitere Optionen, etwa --add image.tif</translation>
    </message>
    <message>
      <source>Registration (folder of all results)</source>
      <translation>Registrierung (Ordner aller Ergebnisse)</translation>
    </message>
    <message>
      <source>Rasters</source>
      <translation>Raster</translation>
    </message>
    <message>
      <source>Layers</source>
      <translation>Layer</translation>
    </message>
    <message>
      <source>Vector layers</source>
      <translation>Vektorlayer</translation>
    </message>
    <message>
      <source>dx</source>
      <translation>dx</translation>
    </message>
    <message>
      <source>dy</source>
      <translation>dy</translation>
    </message>
    <message>
      <source>Angle, degrees</source>
      <translation>Winkel, Grad</translation>
    </message>
    <message>
      <source>Back, onto the uncorrected target</source>
      <translation>Zurück, auf das unkorrigierte Ziel</translation>
    </message>
    <message>
      <source>Folder of raw frames</source>
      <translation>Ordner mit Rohbildern</translation>
    </message>
    <message>
      <source>RIG.json of this camera (not set: learned)</source>
      <translation>RIG.json der Kamera (leer: wird gelernt)</translation>
    </message>
    <message>
      <source>Targets (move)</source>
      <translation>Ziele (werden bewegt)</translation>
    </message>
    <message>
      <source>Bands of each, such as 2,4-6 (not set: all)</source>
      <translation>Kanäle jedes Rasters, etwa 2,4-6 (leer: alle)</translation>
    </message>
    <message>
      <source>Compare every band with this one only</source>
      <translation>Jeden Kanal nur mit diesem vergleichen</translation>
    </message>
    <message>
      <source>Requirement of a mission</source>
      <translation>Anforderung einer Mission</translation>
    </message>
    <message>
      <source>Mask of all rasters (0 = excluded)</source>
      <translation>Maske aller Raster (0 = ausgeschlossen)</translation>
    </message>
    <message>
      <source>Reference (not set: the first)</source>
      <translation>Referenz (leer: die erste)</translation>
    </message>
    <message>
      <source>Reference by its name, instead</source>
      <translation>Referenz nach ihrem Namen, stattdessen</translation>
    </message>
    <message>
      <source>Dates (not set: of layers or file names)</source>
      <translation>Daten (leer: der Layer oder Dateinamen)</translation>
    </message>
    <message>
      <source>What stays</source>
      <translation>Was bleibt</translation>
    </message>
    <message>
      <source>Band of each</source>
      <translation>Kanal eines jeden</translation>
    </message>
    <message>
      <source>Most pairs that are matched (not set: enough)</source>
      <translation>Höchstzahl der Paare (leer: genug)</translation>
    </message>
    <message>
      <source>Wheel of pcwlad-geo (not set: the index)</source>
      <translation>Wheel von pcwlad-geo (leer: der Index)</translation>
    </message>
    <message>
      <source>Or source folder of pcwlad-geo</source>
      <translation>Oder Quellordner von pcwlad-geo</translation>
    </message>
    <message>
      <source>Folder of wheels, without internet</source>
      <translation>Ordner mit Wheels, ohne Internet</translation>
    </message>
    <message>
      <source>Python 3.10 or newer (not set: found)</source>
      <translation>Python 3.10 oder neuer (leer: gefunden)</translation>
    </message>
    <message>
      <source>Median displacement, target pixels</source>
      <translation>Verschiebung (Median), Zielpixel</translation>
    </message>
    <message>
      <source>Median displacement to the right, target pixels</source>
      <translation>Verschiebung nach rechts (Median), Zielpixel</translation>
    </message>
    <message>
      <source>Median displacement down, target pixels</source>
      <translation>Verschiebung nach unten (Median), Zielpixel</translation>
    </message>
    <message>
      <source>RMSE at check points, target pixels</source>
      <translation>RMSE an Kontrollpunkten, Zielpixel</translation>
    </message>
    <message>
      <source>CE90 at check points, target pixels</source>
      <translation>CE90 an Kontrollpunkten, Zielpixel</translation>
    </message>
    <message>
      <source>RMSE at check points, metres</source>
      <translation>RMSE an Kontrollpunkten, Meter</translation>
    </message>
    <message>
      <source>CE90 at check points, metres</source>
      <translation>CE90 an Kontrollpunkten, Meter</translation>
    </message>
    <message>
      <source>Quality: good, fair or poor</source>
      <translation>Qualität: good (gut), fair (mäßig) oder poor (schlecht)</translation>
    </message>
    <message>
      <source>Verdict, in a sentence</source>
      <translation>Urteil in einem Satz</translation>
    </message>
    <message>
      <source>Requirements met</source>
      <translation>Anforderungen erfüllt</translation>
    </message>
    <message>
      <source>Pairs</source>
      <translation>Paare</translation>
    </message>
    <message>
      <source>Pairs refused</source>
      <translation>Abgelehnte Paare</translation>
    </message>
    <message>
      <source>Targets registered</source>
      <translation>Registrierte Ziele</translation>
    </message>
    <message>
      <source>RMSE of a tie point, target pixels</source>
      <translation>RMSE eines Verknüpfungspunkts, Pixel des Ziels</translation>
    </message>
    <message>
      <source>CE90 of a tie point, target pixels</source>
      <translation>CE90 eines Verknüpfungspunkts, Pixel des Ziels</translation>
    </message>
    <message>
      <source>Bias to the right, target pixels</source>
      <translation>Systematischer Fehler nach rechts, Pixel des Ziels</translation>
    </message>
    <message>
      <source>Bias down, target pixels</source>
      <translation>Systematischer Fehler nach unten, Pixel des Ziels</translation>
    </message>
    <message>
      <source>Wrong matches that passed every test</source>
      <translation>Falsche Zuordnungen, die jede Prüfung bestanden</translation>
    </message>
    <message>
      <source>Steps</source>
      <translation>Sprünge</translation>
    </message>
    <message>
      <source>Parts of the ground that move</source>
      <translation>Teile des Geländes, die sich bewegen</translation>
    </message>
    <message>
      <source>Version of the engine</source>
      <translation>Version der Engine</translation>
    </message>
    <message>
      <source>Fits this plugin</source>
      <translation>Passt zu dieser Erweiterung</translation>
    </message>
    <message>
      <source>Oriented phase congruency (precise)</source>
      <translation>Orientierte Phasenkongruenz (genau)</translation>
    </message>
    <message>
      <source>Gradients (fast)</source>
      <translation>Gradienten (schnell)</translation>
    </message>
    <message>
      <source>PCWLAD, as published</source>
      <translation>PCWLAD, wie veröffentlicht</translation>
    </message>
    <message>
      <source>PCLAD, as published</source>
      <translation>PCLAD, wie veröffentlicht</translation>
    </message>
    <message>
      <source>PCLSM, as published</source>
      <translation>PCLSM, wie veröffentlicht</translation>
    </message>
    <message>
      <source>Whole pixels only</source>
      <translation>Nur ganze Pixel</translation>
    </message>
    <message>
      <source>Automatic</source>
      <translation>Automatisch</translation>
    </message>
    <message>
      <source>Shift</source>
      <translation>Verschiebung</translation>
    </message>
    <message>
      <source>Shift and rotation (rigid)</source>
      <translation>Verschiebung und Drehung (starr)</translation>
    </message>
    <message>
      <source>Shift, rotation and scale (similarity, Helmert)</source>
      <translation>Ähnlichkeit (Helmert: Drehung, Maßstab)</translation>
    </message>
    <message>
      <source>Affine (Polynomial 1)</source>
      <translation>Affin (Polynom 1)</translation>
    </message>
    <message>
      <source>Projective</source>
      <translation>Projektiv</translation>
    </message>
    <message>
      <source>Polynomial</source>
      <translation>Polynom</translation>
    </message>
    <message>
      <source>Thin-plate spline</source>
      <translation>Dünne-Platten-Spline</translation>
    </message>
    <message>
      <source>Measured field</source>
      <translation>Gemessenes Feld</translation>
    </message>
    <message>
      <source>Affine and waves (jitter)</source>
      <translation>Affin und Wellen (Jitter)</translation>
    </message>
    <message>
      <source>RPC</source>
      <translation>RPC</translation>
    </message>
    <message>
      <source>The georeferencing only</source>
      <translation>Nur die Georeferenzierung</translation>
    </message>
    <message>
      <source>Search the whole image</source>
      <translation>Das ganze Bild absuchen</translation>
    </message>
    <message>
      <source>None</source>
      <translation>Keine</translation>
    </message>
    <message>
      <source>Nearest neighbour (classes)</source>
      <translation>Nächster Nachbar (Klassen)</translation>
    </message>
    <message>
      <source>Bilinear</source>
      <translation>Bilinear</translation>
    </message>
    <message>
      <source>Cubic</source>
      <translation>Kubisch</translation>
    </message>
    <message>
      <source>Cubic spline</source>
      <translation>Kubischer Spline</translation>
    </message>
    <message>
      <source>Lanczos</source>
      <translation>Lanczos</translation>
    </message>
    <message>
      <source>Sentinel-2</source>
      <translation>Sentinel-2</translation>
    </message>
    <message>
      <source>Landsat OLI</source>
      <translation>Landsat OLI</translation>
    </message>
    <message>
      <source>Landsat TIRS</source>
      <translation>Landsat TIRS</translation>
    </message>
    <message>
      <source>Quick (a sample of points)</source>
      <translation>Schnell (eine Stichprobe der Punkte)</translation>
    </message>
    <message>
      <source>Full (more points, and what the pair tolerates)</source>
      <translation>Voll (mehr Punkte; was das Paar aushält)</translation>
    </message>
    <message>
      <source>The reference</source>
      <translation>Die Referenz</translation>
    </message>
    <message>
      <source>The mean position of all</source>
      <translation>Die mittlere Lage aller</translation>
    </message>
    <message>
      <source>pcwlad,coregistration,coregister,image registration</source>
      <translation>pcwlad,coregistration,coregister,Koregistrierung,Bildregistrierung</translation>
    </message>
    <message>
      <source>align,georeference,georeferencer,thermal,tie points,image matching,warp,rectify,gcp</source>
      <translation>align,ausrichten,georeferenzieren,Georeferenzierer,thermal,Passpunkte,Verknüpfungspunkte,Bildzuordnung,entzerren,gcp</translation>
    </message>
    <message>
      <source>align,tie points,image matching,georeferencer,gcp,thermal</source>
      <translation>align,ausrichten,Passpunkte,Verknüpfungspunkte,Bildzuordnung,Georeferenzierer,gcp,thermal</translation>
    </message>
    <message>
      <source>align,georeference,thermal,batch,image matching</source>
      <translation>align,ausrichten,georeferenzieren,thermal,Stapelverarbeitung,Bildzuordnung</translation>
    </message>
    <message>
      <source>align,georeference,warp,rectify</source>
      <translation>align,ausrichten,georeferenzieren,entzerren</translation>
    </message>
    <message>
      <source>align,time series,georeference,block adjustment</source>
      <translation>align,ausrichten,Zeitreihe,georeferenzieren,Blockausgleichung</translation>
    </message>
    <message>
      <source>thermal,multispectral,drone,uav,bands</source>
      <translation>thermal,multispektral,Drohne,uav,Kanäle</translation>
    </message>
    <message>
      <source>rejected</source>
      <translation>verworfen</translation>
    </message>
    <message>
      <source>not fitted</source>
      <translation>nicht angepasst</translation>
    </message>
    <message>
      <source>check point</source>
      <translation>Kontrollpunkt</translation>
    </message>
    <message>
      <source>residual up to {} px</source>
      <translation>Restfehler bis {} px</translation>
    </message>
    <message>
      <source>residual {} to {} px</source>
      <translation>Restfehler {} bis {} px</translation>
    </message>
    <message>
      <source>residual over {} px</source>
      <translation>Restfehler über {} px</translation>
    </message>
    <message>
      <source>Search radius</source>
      <translation>Suchradius</translation>
    </message>
    <message>
      <source>Tie points wanted</source>
      <translation>Gewünschte Verknüpfungspunkte</translation>
    </message>
    <message>
      <source>Matching window</source>
      <translation>Vergleichsfenster</translation>
    </message>
    <message>
      <source>Processes</source>
      <translation>Prozesse</translation>
    </message>
    <message>
      <source>Requirements</source>
      <translation>Anforderungen</translation>
    </message>
    <message>
      <source>Extent</source>
      <translation>Ausdehnung</translation>
    </message>
    <message>
      <source>Mask of the reference</source>
      <translation>Maske der Referenz</translation>
    </message>
    <message>
      <source>Mask of the target</source>
      <translation>Maske des Ziels</translation>
    </message>
    <message>
      <source>Keep the registered raster although a requirement is not met</source>
      <translation>Das registrierte Raster behalten, obwohl eine Anforderung nicht erfüllt ist</translation>
    </message>
    <message>
      <source>Reading</source>
      <translation>Lesen</translation>
    </message>
    <message>
      <source>Inspecting the captures</source>
      <translation>Aufnahmen werden geprüft</translation>
    </message>
    <message>
      <source>Fetching the map</source>
      <translation>Karte wird geholt</translation>
    </message>
    <message>
      <source>Matching</source>
      <translation>Zuordnen</translation>
    </message>
    <message>
      <source>Refining</source>
      <translation>Verfeinern</translation>
    </message>
    <message>
      <source>Captures that overlap</source>
      <translation>Aufnahmen, die sich überlappen</translation>
    </message>
    <message>
      <source>Testing the rig</source>
      <translation>Die Kamera wird geprüft</translation>
    </message>
    <message>
      <source>Fitting the correction</source>
      <translation>Korrektur anpassen</translation>
    </message>
    <message>
      <source>Measuring the error of the matching</source>
      <translation>Der Fehler der Passung wird gemessen</translation>
    </message>
    <message>
      <source>Captures</source>
      <translation>Aufnahmen</translation>
    </message>
    <message>
      <source>Dates</source>
      <translation>Daten</translation>
    </message>
    <message>
      <source>Writing</source>
      <translation>Schreiben</translation>
    </message>
    <message>
      <source>Warping</source>
      <translation>Entzerren</translation>
    </message>
    <message>
      <source>Vectors</source>
      <translation>Vektoren</translation>
    </message>
    <message>
      <source>Affine</source>
      <translation>Affin</translation>
    </message>
    <message>
      <source>Polynomial 2</source>
      <translation>Polynom 2</translation>
    </message>
    <message>
      <source>Polynomial 3</source>
      <translation>Polynom 3</translation>
    </message>
    <message>
      <source>Enabled</source>
      <translation>Aktiviert</translation>
    </message>
    <message>
      <source>ID</source>
      <translation>ID</translation>
    </message>
    <message>
      <source>Source X</source>
      <translation>Quelle X</translation>
    </message>
    <message>
      <source>Source Y</source>
      <translation>Quelle Y</translation>
    </message>
    <message>
      <source>Dest. X</source>
      <translation>Ziel X</translation>
    </message>
    <message>
      <source>Dest. Y</source>
      <translation>Ziel Y</translation>
    </message>
    <message>
      <source>dX (pixels)</source>
      <translation>dX (Pixel)</translation>
    </message>
    <message>
      <source>dY (pixels)</source>
      <translation>dY (Pixel)</translation>
    </message>
    <message>
      <source>Residual (pixels)</source>
      <translation>Restfehler (Pixel)</translation>
    </message>
    <message>
      <source>Sigma (pixels)</source>
      <translation>Sigma (Pixel)</translation>
    </message>
    <message>
      <source>Status</source>
      <translation>Status</translation>
    </message>
    <message>
      <source>fit</source>
      <translation>Anpassung</translation>
    </message>
    <message>
      <source>matched</source>
      <translation>zugeordnet</translation>
    </message>
    <message>
      <source>check</source>
      <translation>Kontr.</translation>
    </message>
    <message>
      <source>unused</source>
      <translation>nicht benutzt</translation>
    </message>
    <message>
      <source>Quality: {}; 90 % of the common ground is expected to lie within {}</source>
      <translation>Qualität: {}; 90 % des gemeinsamen Geländes liegen voraussichtlich innerhalb von {}</translation>
    </message>
    <message>
      <source>Quality: {}; 90 % of the area is expected to lie within {}, of all that both rasters show {}</source>
      <translation>Qualität: {}; 90 % der Fläche liegen voraussichtlich innerhalb von {}, von allem, was beide Raster zeigen, {}</translation>
    </message>
    <message>
      <source>good</source>
      <translation>gut</translation>
    </message>
    <message>
      <source>fair</source>
      <translation>mäßig</translation>
    </message>
    <message>
      <source>poor</source>
      <translation>schlecht</translation>
    </message>
    <message>
      <source>The layers fit well: 90 % of the common ground is expected to lie within {}.</source>
      <translation>Die Layer passen gut: 90 % des gemeinsamen Geländes liegen voraussichtlich innerhalb von {}.</translation>
    </message>
    <message>
      <source>The layers fit well: 90 % of the area is expected to lie within {}, of the whole layer {}.</source>
      <translation>Die Layer passen gut: 90 % der Fläche liegen voraussichtlich innerhalb von {}, des ganzen Layers von {}.</translation>
    </message>
    <message>
      <source>The layers fit fairly: 90 % of the common ground is expected to lie within {}.</source>
      <translation>Die Layer passen leidlich: 90 % des gemeinsamen Geländes liegen voraussichtlich innerhalb von {}.</translation>
    </message>
    <message>
      <source>The layers fit fairly: 90 % of the area is expected to lie within {}, of the whole layer {}.</source>
      <translation>Die Layer passen leidlich: 90 % der Fläche liegen voraussichtlich innerhalb von {}, des ganzen Layers von {}.</translation>
    </message>
    <message>
      <source>The layers fit poorly: 90 % of the common ground is expected within {} only.</source>
      <translation>Die Layer passen schlecht: 90 % des gemeinsamen Geländes liegen voraussichtlich nur innerhalb von {}.</translation>
    </message>
    <message>
      <source>The layers fit poorly: 90 % of the area is expected within {} only, of the whole layer {}.</source>
      <translation>Die Layer passen schlecht: 90 % der Fläche liegen voraussichtlich nur innerhalb von {}, des ganzen Layers von {}.</translation>
    </message>
    <message>
      <source>{} cannot be written.</source>
      <translation>{} kann nicht geschrieben werden.</translation>
    </message>
    <message>
      <source>Drawing “{}”: {} × {} pixels of {}</source>
      <translation>„{}“ wird gezeichnet: {} × {} Pixel von {}</translation>
    </message>
    <message>
      <source>Nothing says which part of “{}” shows the target. Place the target, or set an extent.</source>
      <translation>Nichts sagt, welcher Teil von „{}“ das Ziel zeigt. Das Ziel platzieren, oder eine Ausdehnung setzen.</translation>
    </message>
    <message>
      <source>{} × {} pixels of “{}” would be drawn, and at most {} are. Set a smaller extent.</source>
      <translation>{} × {} Pixel von „{}“ müssten gezeichnet werden, und höchstens {} werden es. Eine kleinere Ausdehnung setzen.</translation>
    </message>
    <message>
      <source>“{}” shows nothing in more than half of the ground of the target at this scale: its server may refuse, or have no such scale. Look at the map there.</source>
      <translation>„{}“ zeigt in diesem Maßstab auf mehr als der Hälfte des Gebiets nichts: Der Server lehnt vielleicht ab oder hat diesen Maßstab nicht. Die Karte dort ansehen.</translation>
    </message>
    <message>
      <source>“{}” has no CRS. Set one, or that of the project.</source>
      <translation>„{}“ hat kein KBS. Eines setzen, oder das des Projekts.</translation>
    </message>
    <message>
      <source>Residuals, target pixels</source>
      <translation>Restfehler, Zielpixel</translation>
    </message>
    <message>
      <source>The layer “{}” has the CRS {} in QGIS, but its file says {}. That of QGIS is used.</source>
      <translation>Der Layer „{}“ hat in QGIS das KBS {}, aber seine Datei sagt {}. Das von QGIS wird benutzt.</translation>
    </message>
    <message>
      <source>none</source>
      <translation>keines</translation>
    </message>
    <message>
      <source>The layer “{}” is a virtual raster without a file. Save it as a file first.</source>
      <translation>Der Layer „{}“ ist ein virtuelles Raster ohne Datei. Speichern Sie ihn erst als Datei.</translation>
    </message>
    <message>
      <source>The layer “{}” is in memory only. Save it as a file first.</source>
      <translation>Der Layer „{}“ liegt nur im Speicher. Speichern Sie ihn erst als Datei.</translation>
    </message>
    <message>
      <source>Tie points being edited</source>
      <translation>Verknüpfungspunkte in Bearbeitung</translation>
    </message>
    <message>
      <source>Displacement</source>
      <translation>Verschiebung</translation>
    </message>
    <message>
      <source>{}: residual × {:g}</source>
      <translation>{}: Restfehler × {:g}</translation>
    </message>
    <message>
      <source>{}: displacement × {:g}</source>
      <translation>{}: Verschiebung × {:g}</translation>
    </message>
    <message>
      <source>The tie points in {} cannot be read.</source>
      <translation>Die Verknüpfungspunkte in {} sind nicht lesbar.</translation>
    </message>
    <message>
      <source>en</source>
      <translation>de</translation>
    </message>
    <message>
      <source>Registered</source>
      <translation>Registriert</translation>
    </message>
    <message>
      <source>Registered, with care</source>
      <translation>Registriert, mit Vorsicht</translation>
    </message>
    <message>
      <source>Registered, poorly</source>
      <translation>Registriert, aber schlecht</translation>
    </message>
    <message>
      <source>{}, but a requirement is not met</source>
      <translation>{}, aber eine Anforderung ist nicht erfüllt</translation>
    </message>
    <message>
      <source>Matched</source>
      <translation>Zugeordnet</translation>
    </message>
    <message>
      <source>Could not be registered reliably</source>
      <translation>Nicht verlässlich zu registrieren</translation>
    </message>
    <message>
      <source>Tie points matched</source>
      <translation>Verknüpfungspunkte gefunden</translation>
    </message>
    <message>
      <source>Registered: {} to {}</source>
      <translation>Registriert: {} auf {}</translation>
    </message>
    <message>
      <source>Registered, with care: {} to {}</source>
      <translation>Registriert, mit Vorsicht: {} auf {}</translation>
    </message>
    <message>
      <source>Registered, poorly: {} to {}</source>
      <translation>Registriert, aber schlecht: {} auf {}</translation>
    </message>
    <message>
      <source>Could not be registered reliably: {} to {}</source>
      <translation>Nicht verlässlich zu registrieren: {} auf {}</translation>
    </message>
    <message>
      <source>Tie points matched: {} to {}</source>
      <translation>Verknüpfungspunkte gefunden: {} auf {}</translation>
    </message>
    <message>
      <source>{}, but a requirement is not met: {} to {}</source>
      <translation>{}, aber eine Anforderung ist nicht erfüllt: {} auf {}</translation>
    </message>
    <message>
      <source>({}) to</source>
      <translation>({}) auf</translation>
    </message>
    <message>
      <source>({})</source>
      <translation>({})</translation>
    </message>
    <message>
      <source>Before and after</source>
      <translation>Vergleich</translation>
    </message>
    <message>
      <source>The whole scene</source>
      <translation>Die ganze Szene</translation>
    </message>
    <message>
      <source>Numbers</source>
      <translation>Zahlen</translation>
    </message>
    <message>
      <source>Coverage</source>
      <translation>Abdeckung</translation>
    </message>
    <message>
      <source>Residuals</source>
      <translation>Restfehler</translation>
    </message>
    <message>
      <source>Jitter and stripes</source>
      <translation>Jitter und Streifen</translation>
    </message>
    <message>
      <source>Predicted sigma of the correction</source>
      <translation>Vorhergesagtes Sigma der Korrektur</translation>
    </message>
    <message>
      <source>The tool's own error on this pair</source>
      <translation>Der eigene Fehler des Programms an diesem Paar</translation>
    </message>
    <message>
      <source>The tool's own error: {} to {}</source>
      <translation>Der eigene Fehler des Programms: {} auf {}</translation>
    </message>
    <message>
      <source>On this pair the matching itself errs by {} px</source>
      <translation>An diesem Paar irrt die Zuordnung selbst um {} px</translation>
    </message>
    <message>
      <source>90 % of the tie points, moved by known amounts:</source>
      <translation>90 % der Verknüpfungspunkte, um bekannte Beträge bewegt:</translation>
    </message>
    <message>
      <source>All figures:</source>
      <translation>Alle Zahlen:</translation>
    </message>
    <message>
      <source>Warp it yourself</source>
      <translation>Selbst umrechnen</translation>
    </message>
    <message>
      <source>Files</source>
      <translation>Dateien</translation>
    </message>
    <message>
      <source>Inputs, settings and versions</source>
      <translation>Eingaben, Einstellungen und Versionen</translation>
    </message>
    <message>
      <source>When the figures are bad: what to do</source>
      <translation>Wenn die Zahlen schlecht sind: was zu tun ist</translation>
    </message>
    <message>
      <source>After correction by the {} model, 90 % of the {} lie within</source>
      <translation>Nach der Korrektur mit dem Modell {} liegen 90 % der {} innerhalb von</translation>
    </message>
    <message>
      <source>{} check points, which the fit has not seen,</source>
      <translation>{} Kontrollpunkte, die die Anpassung nicht gesehen hat,</translation>
    </message>
    <message>
      <source>{} fit points (there were too few to hold some out)</source>
      <translation>{} Punkte der Anpassung (es waren zu wenige, um welche zurückzuhalten)</translation>
    </message>
    <message>
      <source>of where the target shows them.</source>
      <translation>von dort, wo das Ziel sie zeigt.</translation>
    </message>
    <message>
      <source>How well?</source>
      <translation>Wie gut?</translation>
    </message>
    <message>
      <source>CE90 {} before, {} after the correction</source>
      <translation>CE90 {} vor, {} nach der Korrektur</translation>
    </message>
    <message>
      <source>; nearly all of what is left is noise of the matching itself.</source>
      <translation>; fast alles, was bleibt, ist Rauschen der Zuordnung selbst.</translation>
    </message>
    <message>
      <source>; {} of it once the noise of the matching is taken out.</source>
      <translation>; davon {} ohne das Rauschen der Zuordnung.</translation>
    </message>
    <message>
      <source>90 % of the {} is expected to lie within {}</source>
      <translation>90 % {} liegen voraussichtlich innerhalb von {}</translation>
    </message>
    <message>
      <source>common ground</source>
      <translation>des gemeinsamen Geländes</translation>
    </message>
    <message>
      <source>ground that was compared</source>
      <translation>des verglichenen Geländes</translation>
    </message>
    <message>
      <source>, and of all that both show within {}.</source>
      <translation>, und von allem, was beide zeigen, innerhalb von {}.</translation>
    </message>
    <message>
      <source>All this is relative to the basemap {}</source>
      <translation>All das gilt relativ zur Grundkarte {}</translation>
    </message>
    <message>
      <source>{} m a pixel, fetched {}</source>
      <translation>{} m je Pixel, geholt {}</translation>
    </message>
    <message>
      <source>The correction improves nothing.</source>
      <translation>Die Korrektur verbessert nichts.</translation>
    </message>
    <message>
      <source>Where not?</source>
      <translation>Wo nicht?</translation>
    </message>
    <message>
      <source>{} of the target lies beyond the tie points (hatched below)</source>
      <translation>{} des Ziels liegt jenseits der Verknüpfungspunkte (unten schraffiert)</translation>
    </message>
    <message>
      <source>Less than {} of the target lies beyond the tie points (hatched below)</source>
      <translation>Weniger als {} des Ziels liegt jenseits der Verknüpfungspunkte (unten schraffiert)</translation>
    </message>
    <message>
      <source>{} of the image has no tie point near (see Coverage)</source>
      <translation>{} des Bildes hat keinen Verknüpfungspunkt in der Nähe (siehe Abdeckung)</translation>
    </message>
    <message>
      <source>Less than {} of the image has no tie point near (see Coverage)</source>
      <translation>Weniger als {} des Bildes hat keinen Verknüpfungspunkt in der Nähe (siehe Abdeckung)</translation>
    </message>
    <message>
      <source>less than {} of the image has no tie point near (see Coverage)</source>
      <translation>weniger als {} des Bildes hat keinen Verknüpfungspunkt in der Nähe (siehe Abdeckung)</translation>
    </message>
    <message>
      <source>Tie points cover the whole common area.</source>
      <translation>Verknüpfungspunkte decken die ganze gemeinsame Fläche ab.</translation>
    </message>
    <message>
      <source>less than 1 %</source>
      <translation>weniger als 1 %</translation>
    </message>
    <message>
      <source>Can I trust the figure?</source>
      <translation>Kann ich der Zahl trauen?</translation>
    </message>
    <message>
      <source>With care: there were too few points to keep some out of the fit.</source>
      <translation>Mit Vorsicht: Es waren zu wenige Punkte, um welche aus der Anpassung herauszuhalten.</translation>
    </message>
    <message>
      <source>With care:</source>
      <translation>Mit Vorsicht:</translation>
    </message>
    <message>
      <source>only {} check points, {} are asked for (ASPRS 2023)</source>
      <translation>nur {} Kontrollpunkte, {} werden verlangt (ASPRS 2023)</translation>
    </message>
    <message>
      <source>check points are much worse than fit points: the model does not hold between its points</source>
      <translation>Kontrollpunkte sind viel schlechter als die Punkte der Anpassung: Das Modell hält zwischen seinen Punkten nicht</translation>
    </message>
    <message>
      <source>there are warnings below</source>
      <translation>unten stehen Warnungen</translation>
    </message>
    <message>
      <source>Yes: it is counted at {} check points that the fit has not seen.</source>
      <translation>Ja: Sie ist an {} Kontrollpunkten gezählt, die die Anpassung nicht gesehen hat.</translation>
    </message>
    <message>
      <source>No corrected raster was written, as a requirement is not met; the option</source>
      <translation>Es wurde kein korrigiertes Raster geschrieben, weil eine Anforderung nicht erfüllt ist; die Option</translation>
    </message>
    <message>
      <source>writes it all the same.</source>
      <translation>schreibt es trotzdem.</translation>
    </message>
    <message>
      <source>The reference is red, the target cyan. Where both are equally bright and fit, the sum is grey. A red and a cyan line side by side is a step. Bands of other contrast stay coloured: look at the lines.</source>
      <translation>Die Referenz ist rot, das Ziel cyan. Wo beide gleich hell sind und passen, ist die Summe grau. Eine rote und eine cyanfarbene Linie nebeneinander sind ein Versatz. Kanäle mit anderem Kontrast bleiben farbig: Achten Sie auf die Linien.</translation>
    </message>
    <message>
      <source>How the whole scene is shown</source>
      <translation>Wie die ganze Szene gezeigt wird</translation>
    </message>
    <message>
      <source>Red and cyan</source>
      <translation>Rot und Cyan</translation>
    </message>
    <message>
      <source>Edges of the reference on the target</source>
      <translation>Kanten der Referenz auf dem Ziel</translation>
    </message>
    <message>
      <source>Edges of the reference</source>
      <translation>Kanten der Referenz</translation>
    </message>
    <message>
      <source>Before the correction</source>
      <translation>Vor der Korrektur</translation>
    </message>
    <message>
      <source>After the correction</source>
      <translation>Nach der Korrektur</translation>
    </message>
    <message>
      <source>{}, the target on the same ground</source>
      <translation>{}, das Ziel auf demselben Gelände</translation>
    </message>
    <message>
      <source>Left of the line is the reference, right of it the target. Edges that cross the line must run on without a step. Move the line with the mouse, or with the arrow keys when the slider is chosen. In print both are a checkerboard.</source>
      <translation>Links der Linie ist die Referenz, rechts das Ziel. Kanten, die die Linie kreuzen, müssen ohne Versatz weiterlaufen. Bewegen Sie die Linie mit der Maus, oder mit den Pfeiltasten, wenn der Schieber gewählt ist. Im Druck wird daraus ein Schachbrett.</translation>
    </message>
    <message>
      <source>Reference and target alternate in the squares of a checkerboard. Edges must run on from square to square without a step.</source>
      <translation>Referenz und Ziel wechseln in den Feldern eines Schachbretts. Kanten müssen von Feld zu Feld ohne Versatz weiterlaufen.</translation>
    </message>
    <message>
      <source>{} more place</source>
      <translation>{} weiterer Ort</translation>
    </message>
    <message>
      <source>{} more places</source>
      <translation>{} weitere Orte</translation>
    </message>
    <message>
      <source>the middle</source>
      <translation>die Mitte</translation>
    </message>
    <message>
      <source>the clearest edge</source>
      <translation>die deutlichste Kante</translation>
    </message>
    <message>
      <source>the most distinct match</source>
      <translation>der deutlichste Treffer</translation>
    </message>
    <message>
      <source>the largest residual</source>
      <translation>der größte Restfehler</translation>
    </message>
    <message>
      <source>a clear edge, {}</source>
      <translation>eine deutliche Kante, {}</translation>
    </message>
    <message>
      <source>in the middle</source>
      <translation>in der Mitte</translation>
    </message>
    <message>
      <source>upper left</source>
      <translation>oben links</translation>
    </message>
    <message>
      <source>upper middle</source>
      <translation>oben in der Mitte</translation>
    </message>
    <message>
      <source>upper right</source>
      <translation>oben rechts</translation>
    </message>
    <message>
      <source>middle left</source>
      <translation>links in der Mitte</translation>
    </message>
    <message>
      <source>middle right</source>
      <translation>rechts in der Mitte</translation>
    </message>
    <message>
      <source>lower left</source>
      <translation>unten links</translation>
    </message>
    <message>
      <source>lower middle</source>
      <translation>unten in der Mitte</translation>
    </message>
    <message>
      <source>lower right</source>
      <translation>unten rechts</translation>
    </message>
    <message>
      <source>Around reference column {}, row {}; {} target px wide.</source>
      <translation>Um Spalte {}, Zeile {} der Referenz; {} Zielpixel breit.</translation>
    </message>
    <message>
      <source>Line</source>
      <translation>Linie</translation>
    </message>
    <message>
      <source>Checkerboard</source>
      <translation>Schachbrett</translation>
    </message>
    <message>
      <source>Line between reference and target, {}</source>
      <translation>Linie zwischen Referenz und Ziel, {}</translation>
    </message>
    <message>
      <source>These are figures of a refused pair: they say what was found, not where the target lies.</source>
      <translation>Das sind Zahlen eines abgelehnten Paars: Sie sagen, was gefunden wurde, nicht wo das Ziel liegt.</translation>
    </message>
    <message>
      <source>There is no tie point to count.</source>
      <translation>Es gibt keinen Verknüpfungspunkt zu zählen.</translation>
    </message>
    <message>
      <source>Statistics per axis</source>
      <translation>Statistik je Achse</translation>
    </message>
    <message>
      <source>Radial statistics</source>
      <translation>Statistik der Längen</translation>
    </message>
    <message>
      <source>Per axis, target px</source>
      <translation>Je Achse, Zielpixel</translation>
    </message>
    <message>
      <source>Radial</source>
      <translation>Länge</translation>
    </message>
    <message>
      <source>Points</source>
      <translation>Punkte</translation>
    </message>
    <message>
      <source>axis</source>
      <translation>Achse</translation>
    </message>
    <message>
      <source>unit</source>
      <translation>Einheit</translation>
    </message>
    <message>
      <source>mean</source>
      <translation>Mittel</translation>
    </message>
    <message>
      <source>median</source>
      <translation>Median</translation>
    </message>
    <message>
      <source>std</source>
      <translation>Std.-abw.</translation>
    </message>
    <message>
      <source>net RMSE</source>
      <translation>netto RMSE</translation>
    </message>
    <message>
      <source>net CE90</source>
      <translation>netto CE90</translation>
    </message>
    <message>
      <source>net CE95</source>
      <translation>netto CE95</translation>
    </message>
    <message>
      <source>Before, all points: displacement</source>
      <translation>Vorher, alle Punkte: Verschiebung</translation>
    </message>
    <message>
      <source>After, fit points: residual</source>
      <translation>Nachher, Punkte der Anpassung: Restfehler</translation>
    </message>
    <message>
      <source>After, check points: residual</source>
      <translation>Nachher, Kontrollpunkte: Restfehler</translation>
    </message>
    <message>
      <source>column</source>
      <translation>Spalte</translation>
    </message>
    <message>
      <source>row</source>
      <translation>Zeile</translation>
    </message>
    <message>
      <source>({} points)</source>
      <translation>({} Punkte)</translation>
    </message>
    <message>
      <source>target px</source>
      <translation>Zielpixel</translation>
    </message>
    <message>
      <source>native px</source>
      <translation>eigene Pixel</translation>
    </message>
    <message>
      <source>metres</source>
      <translation>Meter</translation>
    </message>
    <message>
      <source>LE90 is the 90th percentile of the absolute error along an axis; CE90 and CE95 are the 90th and 95th percentile of its length, counted, not derived from a normal distribution. Net: without the noise of the matching, known from the sigma of each point</source>
      <translation>LE90 ist das 90. Perzentil des absoluten Fehlers entlang einer Achse; CE90 und CE95 sind das 90. und 95. Perzentil seiner Länge, gezählt, nicht aus einer Normalverteilung abgeleitet. Netto: ohne das Rauschen der Zuordnung, bekannt aus dem Sigma jedes Punkts</translation>
    </message>
    <message>
      <source>({} px in column, {} px in row)</source>
      <translation>({} px in der Spalte, {} px in der Zeile)</translation>
    </message>
    <message>
      <source>; it is a good figure only as far as those sigmas are.</source>
      <translation>; die Zahl ist nur so gut, wie diese Sigmas es sind.</translation>
    </message>
    <message>
      <source>The native pixel, which the coarser of the two sensors recorded, is {} m.</source>
      <translation>Das eigene Pixel, das der gröbere der beiden Sensoren aufnahm, misst {} m.</translation>
    </message>
    <message>
      <source>Median displacement on the map: {} m (x, y).</source>
      <translation>Verschiebung auf der Karte (Median): {} m (x, y).</translation>
    </message>
    <message>
      <source>Check points were kept out of the fit and of the choice of the model. They come from the same {}, so a bias that {} may have is not in these figures.</source>
      <translation>Kontrollpunkte blieben aus der Anpassung und der Wahl des Modells heraus. Sie kommen aus derselben {}: Ein systematischer Fehler {} ist nicht in diesen Zahlen.</translation>
    </message>
    <message>
      <source>matcher</source>
      <translation>Zuordnung</translation>
    </message>
    <message>
      <source>file</source>
      <translation>Datei</translation>
    </message>
    <message>
      <source>the matcher itself</source>
      <translation>der Zuordnung selbst</translation>
    </message>
    <message>
      <source>its points</source>
      <translation>ihrer Punkte</translation>
    </message>
    <message>
      <source>Cross-validated RMSE of each correction model with two standard errors; the figures are in the table below.</source>
      <translation>Kreuzvalidierter RMSE jedes Korrekturmodells mit zwei Standardfehlern; die Zahlen stehen in der Tabelle darunter.</translation>
    </message>
    <message>
      <source>Each model is fitted without a part of the scene and judged there. The simplest that no other beats is chosen.</source>
      <translation>Jedes Modell wird ohne einen Teil der Szene angepasst und dort beurteilt. Gewählt wird das einfachste, das kein anderes übertrifft.</translation>
    </message>
    <message>
      <source>parameters</source>
      <translation>Parameter</translation>
    </message>
    <message>
      <source>cross-validated RMSE, px</source>
      <translation>kreuzvalidierter RMSE, px</translation>
    </message>
    <message>
      <source>cross-validated RMSE, target px</source>
      <translation>kreuzvalidierter RMSE, Zielpixel</translation>
    </message>
    <message>
      <source>chosen</source>
      <translation>gewählt</translation>
    </message>
    <message>
      <source>{} (chosen)</source>
      <translation>{} (gewählt)</translation>
    </message>
    <message>
      <source>{} predicts better</source>
      <translation>{} sagt besser voraus</translation>
    </message>
    <message>
      <source>not tried: {} is chosen</source>
      <translation>nicht versucht: {} ist gewählt</translation>
    </message>
    <message>
      <source>not tried: {}, which needs no resampling, is not beaten</source>
      <translation>nicht versucht: {}, das keine Neuberechnung braucht, ist nicht übertroffen</translation>
    </message>
    <message>
      <source>does not predict significantly better than {}</source>
      <translation>sagt nicht bedeutend besser voraus als {}</translation>
    </message>
    <message>
      <source>differs from {} by no more than its uncertainty</source>
      <translation>weicht von {} um nicht mehr als seine Unsicherheit ab</translation>
    </message>
    <message>
      <source>The points are those of the file {}; nothing was matched.</source>
      <translation>Die Punkte sind die der Datei {}; es wurde nichts zugeordnet.</translation>
    </message>
    <message>
      <source>Arrows point where the target shows the ground, from where its georeferencing puts it.</source>
      <translation>Pfeile zeigen dorthin, wo das Ziel das Gelände zeigt, von dort, wo seine Georeferenzierung es hinlegt.</translation>
    </message>
    <message>
      <source>After a good correction hardly anything is left to see on the right.</source>
      <translation>Nach einer guten Korrektur ist rechts kaum noch etwas zu sehen.</translation>
    </message>
    <message>
      <source>{} total, {} fit, {} check, {} unused, {} rejected.</source>
      <translation>{} insgesamt, {} in der Anpassung, {} zur Kontrolle, {} ungenutzt, {} verworfen.</translation>
    </message>
    <message>
      <source>{} total, {} matched, {} rejected.</source>
      <translation>{} insgesamt, {} zugeordnet, {} verworfen.</translation>
    </message>
    <message>
      <source>Candidates and what became of them</source>
      <translation>Kandidaten, und was aus ihnen wurde</translation>
    </message>
    <message>
      <source>count</source>
      <translation>Anzahl</translation>
    </message>
    <message>
      <source>tiles</source>
      <translation>Kacheln</translation>
    </message>
    <message>
      <source>candidates</source>
      <translation>Kandidaten</translation>
    </message>
    <message>
      <source>not comparable</source>
      <translation>nicht vergleichbar</translation>
    </message>
    <message>
      <source>not similar</source>
      <translation>nicht ähnlich</translation>
    </message>
    <message>
      <source>at search border</source>
      <translation>am Rand der Suche</translation>
    </message>
    <message>
      <source>not converged</source>
      <translation>nicht konvergiert</translation>
    </message>
    <message>
      <source>directions disagree</source>
      <translation>Richtungen widersprechen sich</translation>
    </message>
    <message>
      <source>second try</source>
      <translation>zweiter Versuch</translation>
    </message>
    <message>
      <source>inconsistent</source>
      <translation>widersprüchlich</translation>
    </message>
    <message>
      <source>consistent</source>
      <translation>stimmig</translation>
    </message>
    <message>
      <source>tie points</source>
      <translation>Verknüpfungspunkte</translation>
    </message>
    <message>
      <source>In squares without tie points the correction is not checked.</source>
      <translation>In Quadraten ohne Verknüpfungspunkte ist die Korrektur nicht geprüft.</translation>
    </message>
    <message>
      <source>Why there are no tie points:</source>
      <translation>Warum es keine Verknüpfungspunkte gibt:</translation>
    </message>
    <message>
      <source>Every square has tie points.</source>
      <translation>Jedes Quadrat hat Verknüpfungspunkte.</translation>
    </message>
    <message>
      <source>no data</source>
      <translation>leer</translation>
    </message>
    <message>
      <source>one of the two has no data there (nodata, masked, outside): nothing can be matched</source>
      <translation>eines der beiden hat dort keine Daten (Nodata, maskiert, außerhalb): Nichts lässt sich zuordnen</translation>
    </message>
    <message>
      <source>at an edge</source>
      <translation>am Rand</translation>
    </message>
    <message>
      <source>too near to an edge or to masked pixels: a smaller --window and --template reach further</source>
      <translation>zu nah an einem Rand oder an maskierten Pixeln: Kleinere --window und --template reichen weiter</translation>
    </message>
    <message>
      <source>unreadable</source>
      <translation>unlesbar</translation>
    </message>
    <message>
      <source>the file is damaged there</source>
      <translation>die Datei ist dort beschädigt</translation>
    </message>
    <message>
      <source>not asked for</source>
      <translation>nicht gefragt</translation>
    </message>
    <message>
      <source>no window was laid there, as enough points were found elsewhere: --points all asks for more</source>
      <translation>dort lag kein Fenster, weil anderswo genug Punkte gefunden wurden: --points all verlangt mehr</translation>
    </message>
    <message>
      <source>no structure</source>
      <translation>strukturlos</translation>
    </message>
    <message>
      <source>flat ground, such as water: another band or date may show more</source>
      <translation>gleichförmiges Gelände, etwa Wasser: Ein anderer Kanal oder Tag kann mehr zeigen</translation>
    </message>
    <message>
      <source>beyond the search</source>
      <translation>außerhalb Suche</translation>
    </message>
    <message>
      <source>most best matches lie on the border of the search: the displacement may be larger (raise --search-radius), or clouds hide the ground</source>
      <translation>die meisten besten Treffer liegen am Rand der Suche: Die Verschiebung kann größer sein (--search-radius erhöhen), oder Wolken verdecken das Gelände</translation>
    </message>
    <message>
      <source>no match</source>
      <translation>erfolglos</translation>
    </message>
    <message>
      <source>what is seen is too different, or repeats: clouds, change, another kind of band</source>
      <translation>was zu sehen ist, ist zu verschieden oder wiederholt sich: Wolken, Veränderung, andere Art von Kanal</translation>
    </message>
    <message>
      <source>there were matches, but they contradict their neighbours: clouds, water, moving things</source>
      <translation>es gab Treffer, aber sie widersprechen ihren Nachbarn: Wolken, Wasser, Bewegtes</translation>
    </message>
    <message>
      <source>Short arrows in all directions are noise. Arrows that run in one direction over an area tell of relief, parallax or a model that is too simple there.</source>
      <translation>Kurze Pfeile in alle Richtungen sind Rauschen. Pfeile, die über eine Fläche in eine Richtung laufen, verraten Relief, Parallaxe oder ein dort zu einfaches Modell.</translation>
    </message>
    <message>
      <source>Bell shapes around zero are good; a dashed line off zero is a bias, two humps are two populations (two sensor strips, ground and clouds). Grey dots are fit points, rings check points; 90 % lie within the circle.</source>
      <translation>Glocken um die Null sind gut; eine gestrichelte Linie neben der Null ist ein systematischer Fehler, zwei Höcker sind zwei Gruppen (zwei Streifen des Sensors, Gelände und Wolken). Graue Punkte sind die der Anpassung, Ringe Kontrollpunkte; 90 % liegen im Kreis.</translation>
    </message>
    <message>
      <source>Black: means of a twelfth of the range with two standard errors. They should stay around zero: waves or slopes depend on the place, so the model misses something (sensor jitter, relief, too simple a model).</source>
      <translation>Schwarz: Mittel je eines Zwölftels des Bereichs mit zwei Standardfehlern. Sie sollten um die Null bleiben: Wellen oder Steigungen hängen vom Ort ab, dem Modell entgeht also etwas (Jitter des Sensors, Relief, zu einfaches Modell).</translation>
    </message>
    <message>
      <source>Displacement (before the correction) of whole rows and columns, less a smooth trend; shaded: 95 % confidence. Bands that hold zero throughout show nothing. A wave is called jitter where chance makes one as strong in less than one of a thousand images;</source>
      <translation>Verschiebung (vor der Korrektur) ganzer Zeilen und Spalten ohne glatten Trend; schattiert: 95 % Konfidenz. Bänder, die überall die Null enthalten, zeigen nichts. Eine Welle heißt Jitter, wo der Zufall in weniger als einem von tausend Bildern eine so starke macht;</translation>
    </message>
    <message>
      <source>takes it out.</source>
      <translation>nimmt ihn heraus.</translation>
    </message>
    <message>
      <source>Median {} px (column, row), largest {} px.</source>
      <translation>Median {} px (Spalte, Zeile), Maximum {} px.</translation>
    </message>
    <message>
      <source>{} of the target, hatched, lie beyond the tie points: there the correction is continued, and sigma says only how well the model is determined.</source>
      <translation>Jenseits der Verknüpfungspunkte (schraffiert) liegen {} des Ziels: Dort wird die Korrektur fortgesetzt, und Sigma sagt nur, wie gut das Modell bestimmt ist.</translation>
    </message>
    <message>
      <source>A thin-plate spline through the tie points, run in this folder:</source>
      <translation>Ein Thin-Plate-Spline durch die Verknüpfungspunkte, in diesem Ordner auszuführen:</translation>
    </message>
    <message>
      <source>before: displacement</source>
      <translation>vorher: Verschiebung</translation>
    </message>
    <message>
      <source>after: residual, same scale</source>
      <translation>nachher: Restfehler, gleicher Maßstab</translation>
    </message>
    <message>
      <source>{} target px</source>
      <translation>{} Zielpixel</translation>
    </message>
    <message>
      <source>reference column, px</source>
      <translation>Spalte der Referenz, px</translation>
    </message>
    <message>
      <source>reference row, px</source>
      <translation>Zeile der Referenz, px</translation>
    </message>
    <message>
      <source>target column, px</source>
      <translation>Spalte des Ziels, px</translation>
    </message>
    <message>
      <source>target row, px</source>
      <translation>Zeile des Ziels, px</translation>
    </message>
    <message>
      <source>column, target px</source>
      <translation>Spalte, Zielpixel</translation>
    </message>
    <message>
      <source>row, target px</source>
      <translation>Zeile, Zielpixel</translation>
    </message>
    <message>
      <source>residual, target px</source>
      <translation>Restfehler, Zielpixel</translation>
    </message>
    <message>
      <source>residual, enlarged</source>
      <translation>Restfehler, vergrößert</translation>
    </message>
    <message>
      <source>fit and check</source>
      <translation>alle Punkte</translation>
    </message>
    <message>
      <source>residual in {}, target px</source>
      <translation>Restfehler in {}, Zielpixel</translation>
    </message>
    <message>
      <source>residual in {}, px</source>
      <translation>Restfehler in {}, px</translation>
    </message>
    <message>
      <source>in {}, px</source>
      <translation>in {}, px</translation>
    </message>
    <message>
      <source>in row</source>
      <translation>Zeile</translation>
    </message>
    <message>
      <source>in column</source>
      <translation>Spalte</translation>
    </message>
    <message>
      <source>points</source>
      <translation>Punkte</translation>
    </message>
    <message>
      <source>displ., px</source>
      <translation>Versch., px</translation>
    </message>
    <message>
      <source>height, m</source>
      <translation>Höhe, m</translation>
    </message>
    <message>
      <source>By height</source>
      <translation>Nach der Höhe</translation>
    </message>
    <message>
      <source>Along the {}s: no wave beyond chance</source>
      <translation>Entlang der {}n: keine Welle über dem Zufall</translation>
    </message>
    <message>
      <source>Along the {}s: jitter of {}</source>
      <translation>Entlang der {}n: Jitter von {}</translation>
    </message>
    <message>
      <source>{} px in {}, period {} px</source>
      <translation>{} px in {}, Periode {} px</translation>
    </message>
    <message>
      <source>predicted sigma, target px</source>
      <translation>vorhergesagtes Sigma, Zielpixel</translation>
    </message>
    <message>
      <source>How large is its own error?</source>
      <translation>Wie groß ist sein eigener Fehler?</translation>
    </message>
    <message>
      <source>90 % of the points lie within {} px</source>
      <translation>90 % der Punkte liegen innerhalb von {} px</translation>
    </message>
    <message>
      <source>, 90 % of the correction within {} px.</source>
      <translation>, 90 % der Korrektur innerhalb von {} px.</translation>
    </message>
    <message>
      <source>Does it lock to whole pixels?</source>
      <translation>Rastet es auf ganze Pixel ein?</translation>
    </message>
    <message>
      <source>Its errors follow the fraction of a pixel by {} px, and scatter by {} px.</source>
      <translation>Seine Fehler folgen dem Bruchteil eines Pixels um {} px und streuen um {} px.</translation>
    </message>
    <message>
      <source>Do the sigmas hold?</source>
      <translation>Stimmen die Sigmas?</translation>
    </message>
    <message>
      <source>{} % of the errors lie within sigma (68 is right)</source>
      <translation>{} % der Fehler liegen innerhalb von Sigma (richtig sind 68)</translation>
    </message>
    <message>
      <source>: they would have to be {} times as large.</source>
      <translation>: Sie müssten {}-mal so groß sein.</translation>
    </message>
    <message>
      <source>, which leaves room for errors that no proof shows.</source>
      <translation>, was Platz für Fehler lässt, die kein Beweis zeigt.</translation>
    </message>
    <message>
      <source>Do wrong matches get through?</source>
      <translation>Kommen falsche Treffer durch?</translation>
    </message>
    <message>
      <source>{} of {} passed every test.</source>
      <translation>{} von {} bestanden jede Prüfung.</translation>
    </message>
    <message>
      <source>What would a blind spot cost?</source>
      <translation>Was kostete ein blinder Fleck?</translation>
    </message>
    <message>
      <source>Without the tie points of a ninth of the scene the {} there would change by up to</source>
      <translation>Ohne die Verknüpfungspunkte eines Neuntels der Szene änderte sich das Modell {} dort um bis zu</translation>
    </message>
    <message>
      <source>What does it tolerate?</source>
      <translation>Was verträgt es?</translation>
    </message>
    <message>
      <source>a displacement of {} px</source>
      <translation>eine Verschiebung von {} px</translation>
    </message>
    <message>
      <source>a rotation of {} degrees</source>
      <translation>eine Drehung von {} Grad</translation>
    </message>
    <message>
      <source>fresh noise of {} times the standard deviation of the images</source>
      <translation>frisches Rauschen vom {}-Fachen der Standardabweichung der Bilder</translation>
    </message>
    <message>
      <source>clouds over a share of {} of the target</source>
      <translation>Wolken über einem Anteil von {} des Ziels</translation>
    </message>
    <message>
      <source>A displacement of {} px</source>
      <translation>Eine Verschiebung von {} px</translation>
    </message>
    <message>
      <source>Not even</source>
      <translation>Nicht einmal</translation>
    </message>
    <message>
      <source>not even</source>
      <translation>nicht einmal</translation>
    </message>
    <message>
      <source>or more</source>
      <translation>oder mehr</translation>
    </message>
    <message>
      <source>beyond, it was refused</source>
      <translation>darüber hinaus wurde abgelehnt</translation>
    </message>
    <message>
      <source>{} results beyond were accepted, and wrong</source>
      <translation>{} Ergebnisse darüber hinaus wurden angenommen und waren falsch</translation>
    </message>
    <message>
      <source>Do both directions agree?</source>
      <translation>Stimmen beide Richtungen überein?</translation>
    </message>
    <message>
      <source>Points return to {} px (RMS) from where they began.</source>
      <translation>Punkte kehren auf {} px (RMS) dorthin zurück, wo sie begannen.</translation>
    </message>
    <message>
      <source>These figures show pixel locking, interpolation and noise. They do not show edges that lie elsewhere in the other band, such as shadows: allow up to {} px for them. Halves of the evidence differ by {} px or more, which is a lower bound. A third band shows more: the triangle of the three must close.</source>
      <translation>Diese Zahlen zeigen das Einrasten auf Pixel, Interpolation und Rauschen. Sie zeigen keine Kanten, die im anderen Kanal anderswo liegen, etwa Schatten: Rechnen Sie dafür bis zu {} px. Hälften des Belegs unterscheiden sich um {} px oder mehr, das ist eine untere Grenze. Ein dritter Kanal zeigt mehr: Das Dreieck der drei muss sich schließen.</translation>
    </message>
    <message>
      <source>The target was moved by {} known amounts and matched again at {} tie points, with fresh noise. Left: what the matching missed the known moves by. Right: flat lines within the grey band are good; a wave means that it is drawn to whole pixels.</source>
      <translation>Das Ziel wurde um {} bekannte Beträge bewegt und an {} Verknüpfungspunkten neu zugeordnet, mit frischem Rauschen. Links: um wie viel die Zuordnung die bekannten Bewegungen verfehlte. Rechts: Flache Linien im grauen Band sind gut; eine Welle heißt, dass es zu ganzen Pixeln gezogen wird.</translation>
    </message>
    <message>
      <source>A part of {} x {} px was made harder by and by and registered as any pair is. Grey: no longer tolerated.</source>
      <translation>Ein Teil von {} x {} px wurde nach und nach schwerer gemacht und wie jedes Paar registriert. Grau: nicht mehr vertragen.</translation>
    </message>
    <message>
      <source>Errors by kind</source>
      <translation>Fehler nach Art</translation>
    </message>
    <message>
      <source>Errors, target px</source>
      <translation>Fehler, Zielpixel</translation>
    </message>
    <message>
      <source>matches</source>
      <translation>Treffer</translation>
    </message>
    <message>
      <source>mean, column</source>
      <translation>Mittel, Spalte</translation>
    </message>
    <message>
      <source>scatter, column</source>
      <translation>Streuung, Spalte</translation>
    </message>
    <message>
      <source>structure: {}</source>
      <translation>Struktur: {}</translation>
    </message>
    <message>
      <source>move: shift</source>
      <translation>Bewegung: Verschiebung</translation>
    </message>
    <message>
      <source>move: turn</source>
      <translation>Bewegung: Drehung</translation>
    </message>
    <message>
      <source>move: field</source>
      <translation>Bewegung: Feld</translation>
    </message>
    <message>
      <source>window: {}</source>
      <translation>Fenster: {}</translation>
    </message>
    <message>
      <source>faintest quarter</source>
      <translation>schwächstes Viertel</translation>
    </message>
    <message>
      <source>second quarter</source>
      <translation>zweites Viertel</translation>
    </message>
    <message>
      <source>third quarter</source>
      <translation>drittes Viertel</translation>
    </message>
    <message>
      <source>strongest quarter</source>
      <translation>stärkstes Viertel</translation>
    </message>
    <message>
      <source>Independent evidence</source>
      <translation>Unabhängiger Beleg</translation>
    </message>
    <message>
      <source>Two halves of the evidence, target px</source>
      <translation>Zwei Hälften des Belegs, Zielpixel</translation>
    </message>
    <message>
      <source>differ by, column</source>
      <translation>Unterschied, Spalte</translation>
    </message>
    <message>
      <source>± column</source>
      <translation>± Spalte</translation>
    </message>
    <message>
      <source>channels</source>
      <translation>Merkmale</translation>
    </message>
    <message>
      <source>windows</source>
      <translation>Fenster</translation>
    </message>
    <message>
      <source>directions</source>
      <translation>Richtungen</translation>
    </message>
    <message>
      <source>errors; 90 % within {} px</source>
      <translation>Fehler; 90 % innerhalb von {} px</translation>
    </message>
    <message>
      <source>fraction of the displacement, px</source>
      <translation>Bruchteil der Verschiebung, px</translation>
    </message>
    <message>
      <source>mean error along a pixel; a wave is pixel locking</source>
      <translation>Fehler je Pixelbruchteil; Welle: Einrasten</translation>
    </message>
    <message>
      <source>error of one match, RMS, target px</source>
      <translation>Fehler eines Treffers, RMS, Zielpixel</translation>
    </message>
    <message>
      <source>where the matching errs</source>
      <translation>wo die Zuordnung irrt</translation>
    </message>
    <message>
      <source>displacement, px</source>
      <translation>Verschiebung, px</translation>
    </message>
    <message>
      <source>rotation, degrees</source>
      <translation>Drehung, Grad</translation>
    </message>
    <message>
      <source>noise, standard deviations</source>
      <translation>Rauschen, Standardabweichungen</translation>
    </message>
    <message>
      <source>clouds, share of the target</source>
      <translation>Wolken, Anteil des Ziels</translation>
    </message>
    <message>
      <source>what a part of the pair tolerates (dot: right, x: refused, x in a ring: wrong; dots: as it lies)</source>
      <translation>was ein Teil des Paars verträgt (Punkt: richtig, x: abgelehnt, x im Ring: falsch; Punkte: wie es liegt)</translation>
    </message>
    <message>
      <source>Too few points</source>
      <translation>Zu wenige Punkte</translation>
    </message>
    <message>
      <source>The overlap is small, flat or masked, or the bands show different things. Choose bands alike in what they show (red and red, near infrared and near infrared), check masks and nodata, ask for more points (</source>
      <translation>Die Überlappung ist klein, gleichförmig oder maskiert, oder die Kanäle zeigen Verschiedenes. Wählen Sie Kanäle, die Gleiches zeigen (Rot und Rot, nahes Infrarot und nahes Infrarot), prüfen Sie Masken und Nodata, verlangen Sie mehr Punkte (</translation>
    </message>
    <message>
      <source>), or lower</source>
      <translation>), oder verkleinern Sie</translation>
    </message>
    <message>
      <source>for small images.</source>
      <translation>für kleine Bilder.</translation>
    </message>
    <message>
      <source>Clouds</source>
      <translation>Wolken</translation>
    </message>
    <message>
      <source>Squares without points or with rejected ones only, over bright areas. Give a cloud mask (</source>
      <translation>Quadrate ohne Punkte oder nur mit verworfenen, über hellen Flächen. Geben Sie eine Wolkenmaske (</translation>
    </message>
    <message>
      <source>: QA_PIXEL, SCL or zeros) or another date.</source>
      <translation>: QA_PIXEL, SCL oder Nullen) oder einen anderen Tag.</translation>
    </message>
    <message>
      <source>Wrong search radius</source>
      <translation>Falscher Suchradius</translation>
    </message>
    <message>
      <source>Many candidates “at search border”, or a refusal. The displacement is larger than the radius: raise</source>
      <translation>Viele Kandidaten „am Rand der Suche“, oder eine Ablehnung. Die Verschiebung ist größer als der Radius: Erhöhen Sie</translation>
    </message>
    <message>
      <source>(the whole image was searched already)</source>
      <translation>(das ganze Bild wurde schon durchsucht)</translation>
    </message>
    <message>
      <source>, or give</source>
      <translation>, oder geben Sie</translation>
    </message>
    <message>
      <source>Relief</source>
      <translation>Relief</translation>
    </message>
    <message>
      <source>Residuals grow with the slopes and change sign across a ridge. The images were not corrected for terrain, or by another elevation model: orthorectify both with the same one, or try</source>
      <translation>Restfehler wachsen mit den Hängen und wechseln das Vorzeichen über einen Grat. Die Bilder wurden nicht um das Gelände korrigiert, oder mit einem anderen Höhenmodell: Orthorektifizieren Sie beide mit demselben, oder versuchen Sie</translation>
    </message>
    <message>
      <source>Parallax of another sensor</source>
      <translation>Parallaxe eines anderen Sensors</translation>
    </message>
    <message>
      <source>Residuals run along one direction, in stripes across the track, or clouds and moving things are displaced and the ground is not. Detectors look at slightly different angles and times; no smooth model takes that out.</source>
      <translation>Restfehler laufen in eine Richtung, in Streifen quer zur Bahn, oder Wolken und Bewegtes sind verschoben und das Gelände nicht. Detektoren blicken unter etwas verschiedenen Winkeln und Zeiten; kein glattes Modell nimmt das heraus.</translation>
    </message>
    <message>
      <source>Check points worse than fit points</source>
      <translation>Kontrollpunkte schlechter als die der Anpassung</translation>
    </message>
    <message>
      <source>The model follows its points and fails between them: take a simpler one (</source>
      <translation>Das Modell folgt seinen Punkten und versagt dazwischen: Nehmen Sie ein einfacheres (</translation>
    </message>
    <message>
      <source>) or more points.</source>
      <translation>) oder mehr Punkte.</translation>
    </message>
    <message>
      <source>A trend over column or row</source>
      <translation>Ein Trend über Spalte oder Zeile</translation>
    </message>
    <message>
      <source>The model is too simple for the sensor:</source>
      <translation>Das Modell ist zu einfach für den Sensor:</translation>
    </message>
    <message>
      <source>or</source>
      <translation>oder</translation>
    </message>
    <message>
      <source>reference</source>
      <translation>Referenz</translation>
    </message>
    <message>
      <source>target</source>
      <translation>Ziel</translation>
    </message>
    <message>
      <source>pre-alignment</source>
      <translation>grobe Ausrichtung</translation>
    </message>
    <message>
      <source>geometry found</source>
      <translation>gefundene Geometrie</translation>
    </message>
    <message>
      <source>{}, shift {} px, search radius {} px; matched by {}</source>
      <translation>{}, Verschiebung {} px, Suchradius {} px; zugeordnet nach {}</translation>
    </message>
    <message>
      <source>georeferencing</source>
      <translation>Georeferenzierung</translation>
    </message>
    <message>
      <source>identity</source>
      <translation>gleiche Pixel</translation>
    </message>
    <message>
      <source>structure</source>
      <translation>Struktur</translation>
    </message>
    <message>
      <source>grey values</source>
      <translation>Grauwerten</translation>
    </message>
    <message>
      <source>, shift {} px, search radius {} px; matched by {}</source>
      <translation>, Verschiebung {} px, Suchradius {} px; zugeordnet nach {}</translation>
    </message>
    <message>
      <source>(evidence {} of at most 4, start {})</source>
      <translation>(Beleg {} von höchstens 4, Start {})</translation>
    </message>
    <message>
      <source>, scale expected by the cameras {}</source>
      <translation>, nach den Kameras erwarteter Maßstab {}</translation>
    </message>
    <message>
      <source>planar</source>
      <translation>eben</translation>
    </message>
    <message>
      <source>: the tie points lie {} px (RMS) across the epipolar lines</source>
      <translation>: Die Verknüpfungspunkte liegen {} px (RMS) quer zu den Epipolarlinien</translation>
    </message>
    <message>
      <source>, and {} px along them beside what one plane gives</source>
      <translation>, und {} px an ihnen entlang neben dem, was eine Ebene ergibt</translation>
    </message>
    <message>
      <source>from {};</source>
      <translation>aus {};</translation>
    </message>
    <message>
      <source>heights from {}, {} m up to the ellipsoid</source>
      <translation>Höhen aus {}, {} m bis zum Ellipsoid</translation>
    </message>
    <message>
      <source>ground taken to be {} m above the ellipsoid</source>
      <translation>Gelände {} m über dem Ellipsoid angenommen</translation>
    </message>
    <message>
      <source>; error of the corrected coefficients {} px</source>
      <translation>; Fehler der korrigierten Koeffizienten {} px</translation>
    </message>
    <message>
      <source>, matrix {}</source>
      <translation>, Matrix {}</translation>
    </message>
    <message>
      <source>(report.json holds it in full)</source>
      <translation>(vollständig in report.json)</translation>
    </message>
    <message>
      <source>model</source>
      <translation>Modell</translation>
    </message>
    <message>
      <source>no CRS</source>
      <translation>kein KBS</translation>
    </message>
    <message>
      <source>{}, {} of {}, {} × {} px, {}, {}</source>
      <translation>{}, {} von {}, {} × {} px, {}, {}</translation>
    </message>
    <message>
      <source>band {}</source>
      <translation>Kanal {}</translation>
    </message>
    <message>
      <source>default</source>
      <translation>Standard</translation>
    </message>
    <message>
      <source>seconds, {}</source>
      <translation>Sekunden, {}</translation>
    </message>
    <message>
      <source>reading</source>
      <translation>Lesen</translation>
    </message>
    <message>
      <source>matching</source>
      <translation>Zuordnen</translation>
    </message>
    <message>
      <source>refining</source>
      <translation>Verfeinern</translation>
    </message>
    <message>
      <source>fitting</source>
      <translation>Anpassen</translation>
    </message>
    <message>
      <source>proving</source>
      <translation>Beweisen</translation>
    </message>
    <message>
      <source>writing</source>
      <translation>Schreiben</translation>
    </message>
    <message>
      <source>report</source>
      <translation>Bericht</translation>
    </message>
    <message>
      <source>warping</source>
      <translation>Umrechnen</translation>
    </message>
    <message>
      <source>Map of the {} tie points on the reference image: arrows for the displacement of each before the correction</source>
      <translation>Karte der {} Verknüpfungspunkte auf dem Bild der Referenz: Pfeile für die Verschiebung jedes Punkts vor der Korrektur</translation>
    </message>
    <message>
      <source>, and beside it the residual after it on the same scale</source>
      <translation>, daneben der Restfehler danach im selben Maßstab</translation>
    </message>
    <message>
      <source>Median displacement {} px (column, row).</source>
      <translation>Verschiebung (Median) {} px (Spalte, Zeile).</translation>
    </message>
    <message>
      <source>Map of the number of tie points in each square of the reference image.</source>
      <translation>Karte der Zahl der Verknüpfungspunkte in jedem Quadrat des Bilds der Referenz.</translation>
    </message>
    <message>
      <source>Squares without any:</source>
      <translation>Quadrate ohne:</translation>
    </message>
    <message>
      <source>Every square has some.</source>
      <translation>Jedes Quadrat hat welche.</translation>
    </message>
    <message>
      <source>Map of the residuals on the reference image, arrows enlarged and coloured by length, with rings on the check points and crosses on rejected points.</source>
      <translation>Karte der Restfehler auf dem Bild der Referenz, Pfeile vergrößert und nach Länge gefärbt, mit Ringen auf den Kontrollpunkten und Kreuzen auf verworfenen Punkten.</translation>
    </message>
    <message>
      <source>Histograms of the residuals in column and in row, and the residuals as points with the circle of CE90.</source>
      <translation>Histogramme der Restfehler in Spalte und Zeile, und die Restfehler als Punkte mit dem Kreis von CE90.</translation>
    </message>
    <message>
      <source>Residuals in column and row against target column, row and, where an elevation model was given, height, with means of stretches.</source>
      <translation>Restfehler in Spalte und Zeile gegen Spalte und Zeile des Ziels und, wo ein Höhenmodell gegeben war, die Höhe, mit Mitteln von Abschnitten.</translation>
    </message>
    <message>
      <source>Displacement along the columns and the rows of the target, and by height where an elevation model was given, less its smooth trend, with 95 % confidence bands.</source>
      <translation>Verschiebung entlang der Spalten und Zeilen des Ziels, und nach der Höhe, wo ein Höhenmodell gegeben war, ohne glatten Trend, mit Bändern von 95 % Konfidenz.</translation>
    </message>
    <message>
      <source>Map of the predicted radial sigma of the correction over the target, with the tie points of the fit; places beyond the tie points are hatched.</source>
      <translation>Karte des vorhergesagten Sigmas der Korrektur über dem Ziel, mit den Punkten der Anpassung; Orte jenseits der Verknüpfungspunkte sind schraffiert.</translation>
    </message>
    <message>
      <source>Left: the errors of the points, column and row, with the circle that holds 90 % of them. Right: their mean by the fraction of a pixel of the displacement.</source>
      <translation>Links: die Fehler der Punkte in Spalte und Zeile, mit dem Kreis, der 90 % von ihnen enthält. Rechts: ihr Mittel nach dem Bruchteil eines Pixels der Verschiebung.</translation>
    </message>
    <message>
      <source>Map of the error of each point on the reference.</source>
      <translation>Karte des Fehlers jedes Punkts auf der Referenz.</translation>
    </message>
    <message>
      <source>Tie points that are kept as a part of the pair is made harder: by displacement, rotation, noise and clouds.</source>
      <translation>Verknüpfungspunkte, die bleiben, während ein Teil des Paars schwerer gemacht wird: durch Verschiebung, Drehung, Rauschen und Wolken.</translation>
    </message>
    <message>
      <source>Align this layer…</source>
      <translation>Diesen Layer ausrichten…</translation>
    </message>
    <message>
      <source>Open the report</source>
      <translation>Bericht öffnen</translation>
    </message>
    <message>
      <source>(Options that begin with -- go into the advanced parameter “More options”.)</source>
      <translation>(Optionen, die mit -- beginnen, gehören in den erweiterten Parameter „Weitere Optionen“.)</translation>
    </message>
    <message>
      <source>Processing option</source>
      <translation>Option der Verarbeitung</translation>
    </message>
    <message>
      <source>{} ({}) is no pcwlad-geo engine; it says: {}</source>
      <translation>{} ({}) ist keine Engine pcwlad-geo; die Antwort ist: {}</translation>
    </message>
    <message>
      <source>installed by the plugin</source>
      <translation>von der Erweiterung installiert</translation>
    </message>
    <message>
      <source>The engine {} that the {} names does not exist. Correct it, or clear it.</source>
      <translation>Die Engine {}, die unter {} genannt ist, gibt es nicht. Berichtigen oder löschen Sie den Eintrag.</translation>
    </message>
    <message>
      <source>The engine {} does not start: {}</source>
      <translation>Die Engine {} startet nicht: {}</translation>
    </message>
    <message>
      <source>nothing (status {})</source>
      <translation>nichts (Status {})</translation>
    </message>
    <message>
      <source>Median displacement of the target: {:+.3f} px to the right, {:+.3f} px down</source>
      <translation>Mittlere Verschiebung des Ziels (Median): {:+.3f} px nach rechts, {:+.3f} px nach unten</translation>
    </message>
    <message>
      <source>Tie points: {:.0f}</source>
      <translation>Verknüpfungspunkte: {:.0f}</translation>
    </message>
    <message>
      <source> (RMSE {RMSE_M:.2f} m, CE90 {CE90_M:.2f} m)</source>
      <translation> (RMSE {RMSE_M:.2f} m, CE90 {CE90_M:.2f} m)</translation>
    </message>
    <message>
      <source>{:.0f} tie points were found.</source>
      <translation>{:.0f} Verknüpfungspunkte wurden gefunden.</translation>
    </message>
    <message>
      <source>Model: {}</source>
      <translation>Modell: {}</translation>
    </message>
    <message>
      <source>What is left: RMSE {RMSE:.3f} px, CE90 {CE90:.3f} px</source>
      <translation>Es bleiben: RMSE {RMSE:.3f} px, CE90 {CE90:.3f} px</translation>
    </message>
    <message>
      <source>All this is relative to the basemap {}.</source>
      <translation>All das gilt relativ zur Grundkarte {}.</translation>
    </message>
    <message>
      <source>{}: no tiepoints.gpkg. Register again without --no-report.</source>
      <translation>{}: keine tiepoints.gpkg. Registrieren Sie das Paar erneut, ohne --no-report.</translation>
    </message>
    <message>
      <source>{} is no folder of a finished registration.</source>
      <translation>{} ist kein Ordner einer fertigen Registrierung.</translation>
    </message>
    <message>
      <source>No Python 3.10 or newer was found. Install one (python.org), and name it under “Python”.</source>
      <translation>Kein Python 3.10 oder neuer wurde gefunden. Installieren Sie eines (python.org), und nennen Sie es unter „Python“.</translation>
    </message>
    <message>
      <source>Give either a wheel or a source folder of pcwlad-geo, not both.</source>
      <translation>Geben Sie entweder ein Wheel oder einen Quellordner von pcwlad-geo an, nicht beides.</translation>
    </message>
    <message>
      <source>{} is no source folder of pcwlad-geo: it has no pyproject.toml of that name.</source>
      <translation>{} ist kein Quellordner von pcwlad-geo: Er hat keine pyproject.toml dieses Namens.</translation>
    </message>
    <message>
      <source>The folder {} holds no wheels that do. On a computer with internet: {}</source>
      <translation>Im Ordner {} liegen keine brauchbaren Wheels. Auf einem Rechner mit Internet: {}</translation>
    </message>
    <message>
      <source>Making the virtual environment</source>
      <translation>Virtuelle Umgebung wird angelegt</translation>
    </message>
    <message>
      <source>The installation failed (status {}) at: {}</source>
      <translation>Die Installation ist gescheitert (Status {}) bei: {}</translation>
    </message>
    <message>
      <source>Installing</source>
      <translation>Installieren</translation>
    </message>
    <message>
      <source>Downloading and installing</source>
      <translation>Herunterladen und installieren</translation>
    </message>
    <message>
      <source>{} is no wheel of pcwlad-geo (pcwlad_geo-….whl).</source>
      <translation>{} ist kein Wheel von pcwlad-geo (pcwlad_geo-….whl).</translation>
    </message>
    <message>
      <source>Its last lines:</source>
      <translation>Ihre letzten Zeilen:</translation>
    </message>
    <message>
      <source>The pair was refused, and nothing was corrected: {}</source>
      <translation>Das Paar wurde abgelehnt und nichts korrigiert: {}</translation>
    </message>
    <message>
      <source>The engine ended with status {} and without a result.</source>
      <translation>Die Engine endete mit Status {} und ohne Ergebnis.</translation>
    </message>
    <message>
      <source>The engine does not start: {}</source>
      <translation>Die Engine startet nicht: {}</translation>
    </message>
    <message>
      <source>Engine: a Python with pcwlad-geo in it, or the program pcwlad-geo</source>
      <translation>Engine: ein Python, in dem pcwlad-geo liegt, oder das Programm pcwlad-geo</translation>
    </message>
    <message>
      <source>only {} of {} candidates agree with their neighbours, in {} of {} separate places</source>
      <translation>nur {} von {} Kandidaten stimmen mit ihren Nachbarn überein, an {} von {} getrennten Orten</translation>
    </message>
    <message>
      <source>none of the {} candidates agrees with its neighbours</source>
      <translation>keiner der {} Kandidaten stimmt mit seinen Nachbarn überein</translation>
    </message>
    <message>
      <source>no better than chance</source>
      <translation>nicht besser als der Zufall</translation>
    </message>
    <message>
      <source>{} tie points agree, in {} of {} separate places, and so few say too little</source>
      <translation>{} Verknüpfungspunkte stimmen überein, an {} von {} getrennten Orten, und so wenige sagen zu wenig</translation>
    </message>
    <message>
      <source>at least {} are needed</source>
      <translation>mindestens {} sind nötig</translation>
    </message>
    <message>
      <source>points within a matching window say the same: more places are needed</source>
      <translation>Punkte in einem Vergleichsfenster sagen dasselbe: es braucht mehr Orte</translation>
    </message>
    <message>
      <source>use rasters that share more ground, masks that exclude less, or a smaller --window</source>
      <translation>nehmen Sie Raster, die mehr Gelände gemeinsam haben, Masken, die weniger ausschließen, oder ein kleineres --window</translation>
    </message>
    <message>
      <source>no structure to match: the overlap is flat, masked or too small; check bands, masks and nodata</source>
      <translation>keine Struktur zum Vergleichen: die gemeinsame Fläche ist eintönig, maskiert oder zu klein; prüfen Sie Kanäle, Masken und Nodata</translation>
    </message>
    <message>
      <source>almost no window has enough valid pixels in both images; check masks, nodata and overlap</source>
      <translation>fast kein Fenster hat in beiden Bildern genug gültige Pixel; prüfen Sie Masken, Nodata und Überlappung</translation>
    </message>
    <message>
      <source>the candidates agree only up to multiples of {} px: both images show the grid of blocks that JPEG compression leaves, and little else; use images without it, or mask what shows nothing else</source>
      <translation>die Kandidaten stimmen nur bis auf Vielfache von {} px überein: beide Bilder zeigen das Blockraster der JPEG-Kompression und wenig sonst; nehmen Sie Bilder ohne dieses, oder maskieren Sie, was nichts anderes zeigt</translation>
    </message>
    <message>
      <source>the common area is {} x {} px of the matching grid: too small to match (at least {} px a side); use rasters that share more ground</source>
      <translation>die gemeinsame Fläche ist {} x {} px des Suchgitters groß: zu klein zum Vergleichen (mindestens {} px je Seite); nehmen Sie Raster, die mehr Gelände gemeinsam haben</translation>
    </message>
    <message>
      <source>has no valid pixel (nodata, masks) where the two overlap: check its nodata value, its mask, or choose another band</source>
      <translation>hat kein gültiges Pixel (Nodata, Masken), wo sich die beiden überlappen: prüfen Sie den Nodata-Wert, die Maske, oder wählen Sie einen anderen Kanal</translation>
    </message>
    <message>
      <source>is constant where the two overlap: there is nothing to match; choose another band</source>
      <translation>ist konstant, wo sich die beiden überlappen: es gibt nichts zu vergleichen; wählen Sie einen anderen Kanal</translation>
    </message>
    <message>
      <source>the rasters do not overlap: in {}, {} covers {} and {} covers {}: give two rasters of the same ground, or correct their georeferencing</source>
      <translation>die Raster überlappen sich nicht: in {} bedeckt {} {} und {} {}: wählen Sie zwei Raster desselben Geländes, oder berichtigen Sie ihre Georeferenzierung</translation>
    </message>
    <message>
      <source>bands of a product lie within metres of each other, and the matches agree on {}, probably clouds: mask them (--ref-mask, --tgt-mask), or give --prealign search if a band has been moved</source>
      <translation>Kanäle eines Produkts liegen auf Meter genau beieinander, und die Treffer einigen sich auf {}, wohl Wolken: maskieren Sie diese (--ref-mask, --tgt-mask), oder wählen Sie --prealign search, wenn ein Kanal verschoben wurde</translation>
    </message>
    <message>
      <source>and nothing tells which is that of the ground: give a mask (--ref-mask, --tgt-mask) with 0 on clouds and what else moves, or --prealign georef with a small --search-radius</source>
      <translation>und nichts sagt, welche die des Geländes ist: geben Sie eine Maske (--ref-mask, --tgt-mask) mit 0 auf Wolken und was sich sonst bewegt, oder --prealign georef mit einem kleinen --search-radius</translation>
    </message>
    <message>
      <source>only {} % of the matches agree with their neighbours</source>
      <translation>nur {} % der Treffer stimmen mit ihren Nachbarn überein</translation>
    </message>
    <message>
      <source>{} % of the common ground lies beyond the tie points</source>
      <translation>{} % des gemeinsamen Geländes liegen jenseits der Verknüpfungspunkte</translation>
    </message>
    <message>
      <source>and the correction does not hold</source>
      <translation>und die Korrektur trägt nicht</translation>
    </message>
    <message>
      <source>Mask what moves, or choose images that are alike in what they show and taken from nearby viewpoints</source>
      <translation>Maskieren Sie, was sich bewegt, oder wählen Sie Bilder, die Ähnliches zeigen und von ähnlichem Standpunkt aufgenommen sind</translation>
    </message>
    <message>
      <source>the two agree at exactly the same pixels of both files, and</source>
      <translation>die beiden stimmen an genau denselben Pixeln beider Dateien überein, und</translation>
    </message>
    <message>
      <source>only in what stands still in both frames</source>
      <translation>nur in dem, was in beiden Bildern stillsteht</translation>
    </message>
    <message>
      <source>perhaps only in what stands still in both frames</source>
      <translation>vielleicht nur in dem, was in beiden Bildern stillsteht</translation>
    </message>
    <message>
      <source>a fixed pattern of the sensor, dust, vignetting, or text, lines and masks burnt in</source>
      <translation>ein festes Muster des Sensors, Staub, Randabfall, oder eingebrannter Text, Linien und Masken</translation>
    </message>
    <message>
      <source>only {} % of the places with structure agree there</source>
      <translation>nur {} % der Orte mit Struktur stimmen dort überein</translation>
    </message>
    <message>
      <source>once smoothed</source>
      <translation>nach Glättung</translation>
    </message>
    <message>
      <source>without small specks that both have</source>
      <translation>ohne kleine Flecken, die beide haben</translation>
    </message>
    <message>
      <source>without what whole columns or rows share</source>
      <translation>ohne das, was ganze Spalten oder Zeilen gemeinsam haben</translation>
    </message>
    <message>
      <source>without what differs from pixel to pixel as a sensor's pattern does</source>
      <translation>ohne das, was wie das Muster eines Sensors von Pixel zu Pixel wechselt</translation>
    </message>
    <message>
      <source>without it there is ground that has moved by about ({}, {}) px</source>
      <translation>ohne dieses zeigt sich Gelände, das um etwa ({}, {}) px verschoben ist</translation>
    </message>
    <message>
      <source>mask it, correct the frames for it, or give their georeferencing</source>
      <translation>maskieren Sie es, bereinigen Sie die Bilder davon, oder geben Sie ihre Georeferenzierung</translation>
    </message>
    <message>
      <source>by the positions in their tags the cameras were {} m apart, and by focal length and height the frames show</source>
      <translation>nach den Positionen in ihren Metadaten waren die Kameras {} m auseinander, und nach Brennweite und Höhe zeigen die Bilder</translation>
    </message>
    <message>
      <source>what agrees may belong to the camera (its fixed pattern, dust, burnt-in text), or the ground repeats</source>
      <translation>was übereinstimmt, kann zur Kamera gehören (festes Muster, Staub, eingebrannter Text), oder das Gelände wiederholt sich</translation>
    </message>
    <message>
      <source>the {} points of {} describe no common displacement (they scatter by {} of their spread): check their columns, and whose they are</source>
      <translation>die {} Punkte von {} beschreiben keine gemeinsame Verschiebung (sie streuen um {} ihrer Ausdehnung): prüfen Sie ihre Spalten, und wozu sie gehören</translation>
    </message>
    <message>
      <source>the search proposes ({}, {}) px (col, row), as it does by chance in one of {} pairs, and no tie points confirm it: check it by eye</source>
      <translation>die Suche schlägt ({}, {}) px (Spalte, Zeile) vor, wie zufällig bei einem von {} Paaren, und keine Verknüpfungspunkte bestätigen es: prüfen Sie es mit dem Auge</translation>
    </message>
    <message>
      <source>{} has little more than two values, as a mask or a map of classes: match an image that it was made from, and move it by what that gives (shift)</source>
      <translation>{} hat kaum mehr als zwei Werte, wie eine Maske oder Klassenkarte: vergleichen Sie ein Bild, aus dem es entstand, und verschieben Sie es um dessen Ergebnis</translation>
    </message>
    <message>
      <source>fill small gaps (gdal_fillnodata.py), around which too few pixels are valid, or</source>
      <translation>füllen Sie kleine Lücken (gdal_fillnodata.py), um die zu wenige Pixel gültig sind, oder</translation>
    </message>
    <message>
      <source>if the two share a small part only, or their pixels differ more than four times in size, give both a rough geotransform (gdal_edit.py -a_ullr), right to some pixels, or</source>
      <translation>haben die beiden nur wenig gemeinsam, oder sind ihre Pixel mehr als viermal verschieden groß, geben Sie beiden eine grobe Georeferenzierung (gdal_edit.py -a_ullr), auf einige Pixel genau, oder</translation>
    </message>
    <message>
      <source>choose bands that look alike, or mask clouds and what has changed, unless the two do not show the same place</source>
      <translation>wählen Sie Kanäle, die sich ähnlich sehen, oder maskieren Sie Wolken und was sich verändert hat, es sei denn, die beiden zeigen nicht denselben Ort</translation>
    </message>
    <message>
      <source>many best matches lie on the edge of the search radius of {} px</source>
      <translation>viele beste Treffer liegen am Rand des Suchradius von {} px</translation>
    </message>
    <message>
      <source>raise --search-radius, or give --prealign search</source>
      <translation>erhöhen Sie --search-radius, oder wählen Sie --prealign search</translation>
    </message>
    <message>
      <source>the displacement may exceed the search radius of {} px (raise --search-radius), or the two may be turned against each other (give --prealign search)</source>
      <translation>die Verschiebung kann größer sein als der Suchradius von {} px (erhöhen Sie --search-radius), oder die beiden sind gegeneinander gedreht (wählen Sie --prealign search)</translation>
    </message>
    <message>
      <source>this is the best of {} starts, which a search over all rotations, scales and shifts found at</source>
      <translation>das ist der beste von {} Ansätzen, die eine Suche über alle Drehungen, Maßstäbe und Verschiebungen fand, bei</translation>
    </message>
    <message>
      <source>a search over the whole image found no start that holds</source>
      <translation>eine Suche über das ganze Bild fand keinen Ansatz, der trägt</translation>
    </message>
    <message>
      <source>around the shift that a search over the whole image found: give --prealign search with --search-radius</source>
      <translation>um die Verschiebung, die eine Suche über das ganze Bild fand: wählen Sie --prealign search mit --search-radius</translation>
    </message>
    <message>
      <source>this is from the shift that a search over the whole image found</source>
      <translation>das gilt für die Verschiebung, die eine Suche über das ganze Bild fand</translation>
    </message>
    <message>
      <source>rotation {} degrees, scale {} x {}, shear {} degrees</source>
      <translation>Drehung {} Grad, Maßstab {} x {}, Scherung {} Grad</translation>
    </message>
    <message>
      <source>The pixels of the {} may be {} times as small, and scales about that were tried too, as were those from ¼ to 4: if the true scale is another, reduce the larger frame first (gdal_translate -outsize)</source>
      <translation>Die Pixel eines der Bilder ({}) sind vielleicht {}-mal so klein; Maßstäbe um diesen wurden auch versucht, wie die von ¼ bis 4: ist der wahre ein anderer, verkleinern Sie erst das größere Bild (gdal_translate -outsize)</translation>
    </message>
    <message>
      <source>check also that the RPC in {} belongs to the target as it is, not to an image that it was cropped or decimated from</source>
      <translation>prüfen Sie auch, ob der RPC in {} zum Ziel gehört, wie es ist, nicht zu einem Bild, aus dem es ausgeschnitten oder verkleinert wurde</translation>
    </message>
    <message>
      <source>{} % of the matches agree on another displacement, ({}, {}) px beside the correction: what has moved, or ground at another depth, where it does not hold</source>
      <translation>{} % der Treffer einigen sich auf eine andere Verschiebung, ({}, {}) px neben der Korrektur: was sich bewegt hat, oder Gelände in anderer Tiefe, wo sie nicht gilt</translation>
    </message>
    <message>
      <source>a tenth of the common ground is expected to lie more than {} px off after the {} correction</source>
      <translation>ein Zehntel des gemeinsamen Geländes liegt voraussichtlich mehr als {} px daneben, auch nach der Korrektur ({})</translation>
    </message>
    <message>
      <source>clouds that moved, relief, parallax, or too few tie points</source>
      <translation>Wolken, die sich bewegt haben, Relief, Parallaxe oder zu wenige Verknüpfungspunkte</translation>
    </message>
    <message>
      <source>rows or columns move by {} px (RMS) within a matching window (jitter)</source>
      <translation>Zeilen oder Spalten bewegen sich um {} px (RMS) innerhalb eines Vergleichsfensters (Jitter)</translation>
    </message>
    <message>
      <source>the displacement bends by {} px (RMS) within a matching window</source>
      <translation>die Verschiebung krümmt sich um {} px (RMS) innerhalb eines Vergleichsfensters</translation>
    </message>
    <message>
      <source>a tenth of the {} check points lies more than {} px off the correction, {} times what their sigmas say</source>
      <translation>ein Zehntel der {} Kontrollpunkte liegt mehr als {} px neben der Korrektur, das {}-Fache dessen, was ihre Sigmas sagen</translation>
    </message>
    <message>
      <source>local displacements of {} px (68 % of the points) remain that the {} model does not take out: parallax of another viewpoint, relief or sensor jitter</source>
      <translation>örtliche Verschiebungen von {} px (68 % der Punkte) bleiben, die das Modell {} nicht herausnimmt: Parallaxe eines anderen Standpunkts, Relief oder Jitter des Sensors</translation>
    </message>
    <message>
      <source>the matching is no more precise on this pair</source>
      <translation>der Vergleich ist bei diesem Paar nicht genauer</translation>
    </message>
    <message>
      <source>most of them fit; the others lie on what moved, such as clouds, or at another depth</source>
      <translation>die meisten passen; die anderen liegen auf Bewegtem wie Wolken, oder in anderer Tiefe</translation>
    </message>
    <message>
      <source>noise of the images, or displacements smaller than a matching window</source>
      <translation>Rauschen der Bilder, oder Verschiebungen kleiner als ein Vergleichsfenster</translation>
    </message>
    <message>
      <source>{} % of the common ground lies beyond the tie points: there the correction is extrapolated, and nothing checks it</source>
      <translation>{} % des gemeinsamen Geländes liegen jenseits der Verknüpfungspunkte: dort ist die Korrektur extrapoliert, und nichts prüft sie</translation>
    </message>
    <message>
      <source>{} % of the common ground shows nothing that could be matched, such as water, and lies beyond the tie points: the grade and the expected error are of the rest</source>
      <translation>{} % des gemeinsamen Geländes zeigen nichts, was sich vergleichen ließ, wie Wasser, und liegen jenseits der Verknüpfungspunkte: Note und erwarteter Fehler gelten für den Rest</translation>
    </message>
    <message>
      <source>the {} correction bends beyond the tie points: {} % of the common ground shows nothing that could be matched, and lies up to {} px off the affine trend of the points. Choose --model affine if that ground matters</source>
      <translation>die Korrektur ({}) biegt sich jenseits der Verknüpfungspunkte: {} % des gemeinsamen Geländes zeigen nichts, was sich vergleichen ließ, und liegen bis zu {} px neben dem affinen Trend der Punkte. Wählen Sie --model affine, wenn dieses Gelände wichtig ist</translation>
    </message>
    <message>
      <source>a tenth of the tie points say that bands of one product lie more than {} m apart, which its geometry hardly allows: they may be on clouds, which each band sees elsewhere</source>
      <translation>nach einem Zehntel der Verknüpfungspunkte liegen Kanäle eines Produkts mehr als {} m auseinander, was dessen Geometrie kaum zulässt: sie liegen wohl auf Wolken, die jeder Kanal anderswo sieht</translation>
    </message>
    <message>
      <source>the ground repeats, and the whole scene fits better at {}{} px (col, row) from the georeferencing: the tie points are probably one or more periods off; give --prealign search, or a better geotransform</source>
      <translation>das Gelände wiederholt sich, und die ganze Szene passt besser bei {}{} px (Spalte, Zeile) von der Georeferenzierung: die Verknüpfungspunkte liegen wohl eine oder mehr Perioden daneben; wählen Sie --prealign search, oder geben Sie eine bessere Georeferenzierung</translation>
    </message>
    <message>
      <source>the ground repeats, and the whole scene fits about as well at {}{} px (col, row) from the georeferencing: the tie points may be one or more periods off; check a place that does not repeat</source>
      <translation>das Gelände wiederholt sich, und die ganze Szene passt etwa gleich gut bei {}{} px (Spalte, Zeile) von der Georeferenzierung: die Verknüpfungspunkte können eine oder mehr Perioden daneben liegen; prüfen Sie einen Ort, der sich nicht wiederholt</translation>
    </message>
    <message>
      <source>{} % of the ground with structure, in one part, has no tie points and lies at about ({}, {}) px (col, row) from the georeferencing, {} px from the rest: a seam of a mosaic, what has moved, or clouds; there the correction does not hold. Where it is ground, raise --search-radius</source>
      <translation>{} % des Geländes mit Struktur, in einem Stück, haben keine Verknüpfungspunkte und liegen etwa ({}, {}) px (Spalte, Zeile) von der Georeferenzierung, {} px vom Rest: eine Mosaiknaht, Bewegtes oder Wolken; dort gilt die Korrektur nicht. Wo es Gelände ist, erhöhen Sie --search-radius</translation>
    </message>
    <message>
      <source>the residuals run along the parallax of height: a tenth of them are over {} px along it, {} px across: the DEM {} errs by {} m and more there, which no correction takes out; give a finer or better one</source>
      <translation>die Restfehler folgen der Höhenparallaxe: ein Zehntel ist längs über {} px, quer {} px: das DGM {} irrt dort um {} m und mehr, was keine Korrektur herausnimmt; geben Sie ein feineres oder besseres</translation>
    </message>
    <message>
      <source>the tie points are of a file without the results of their matching beside it: their own errors, and whether they were chosen by their residuals, are not known, so all figures may be too good</source>
      <translation>die Verknüpfungspunkte sind aus einer Datei, neben der die Ergebnisse ihres Vergleichs fehlen: ihre eigenen Fehler, und ob sie nach ihren Restfehlern ausgewählt wurden, sind unbekannt, alle Zahlen also vielleicht zu gut</translation>
    </message>
    <message>
      <source>no georeferencing that the two share (CRS and geotransform) in</source>
      <translation>keine gemeinsame Georeferenzierung (KBS und Geotransformation) in</translation>
    </message>
    <message>
      <source>only their pixels tell how the two lie</source>
      <translation>nur ihre Pixel sagen, wie die beiden liegen</translation>
    </message>
    <message>
      <source>only the tie points given tell how the two lie</source>
      <translation>nur die gegebenen Verknüpfungspunkte sagen, wie die beiden liegen</translation>
    </message>
    <message>
      <source>the two share too little structure and are matched by the relation of their grey values, from which slopes and shadows may depart: tie points share an error of some {} px per axis, which is part of their sigmas</source>
      <translation>die beiden haben zu wenig Struktur gemeinsam und werden nach dem Zusammenhang ihrer Grauwerte verglichen, von dem Hänge und Schatten abweichen können: die Verknüpfungspunkte teilen einen Fehler von etwa {} px je Achse, der Teil ihrer Sigmas ist</translation>
    </message>
    <message>
      <source>--place is off</source>
      <translation>die Lage von Hand liegt daneben</translation>
    </message>
    <message>
      <source>the georeferencing is off</source>
      <translation>die Georeferenzierung liegt daneben</translation>
    </message>
    <message>
      <source>by about ({}, {}) px (col, row; of the coarser raster): found by a search</source>
      <translation>um etwa ({}, {}) px (Spalte, Zeile; des gröberen Rasters): von einer Suche gefunden</translation>
    </message>
    <message>
      <source>a search found the target at {}, beside where that puts it</source>
      <translation>eine Suche fand das Ziel bei {}, gegenüber dem Ort, den sie ihm gibt</translation>
    </message>
    <message>
      <source>tile {} left out</source>
      <translation>Kachel {} ausgelassen</translation>
    </message>
    <message>
      <source>windows of {} px give too few separate places to judge by: matched again with windows of {} px</source>
      <translation>Fenster von {} px geben zu wenige getrennte Orte für ein Urteil: noch einmal verglichen mit Fenstern von {} px</translation>
    </message>
    <message>
      <source>narrow overlap of {} px: matching windows shrunk to {} px (coarse), {} px (fine)</source>
      <translation>schmale Überlappung von {} px: Vergleichsfenster verkleinert auf {} px (grob), {} px (fein)</translation>
    </message>
    <message>
      <source>has an RPC, which counts for a reference with a DEM only: it is not used</source>
      <translation>hat einen RPC, der bei einer Referenz nur mit DGM zählt: er wird nicht benutzt</translation>
    </message>
    <message>
      <source>has a geotransform and an RPC: the RPC is not used; give --dem to use it</source>
      <translation>hat eine Geotransformation und einen RPC: der RPC wird nicht benutzt; geben Sie --dem, um ihn zu benutzen</translation>
    </message>
    <message>
      <source>the matches agree on {} different displacements</source>
      <translation>die Treffer einigen sich auf {} verschiedene Verschiebungen</translation>
    </message>
    <message>
      <source>px by {} points in {} separate places</source>
      <translation>px nach {} Punkten an {} getrennten Orten</translation>
    </message>
    <message>
      <source>the first was taken for that of the ground, the rest for clouds, what else moves or lies at another depth; there the correction does not hold</source>
      <translation>die erste wurde für die des Geländes genommen, der Rest für Wolken, was sich sonst bewegt oder in anderer Tiefe liegt; dort gilt die Korrektur nicht</translation>
    </message>
    <message>
      <source>the displacement holds parallax: {} px (RMS) across the epipolar lines, {} px along them beside what one plane gives: the tie points are right at every depth, and one smooth correction cannot follow them all</source>
      <translation>die Verschiebung enthält Parallaxe: {} px (RMS) quer zu den Epipolarlinien, {} px längs neben dem, was eine Ebene ergibt: die Verknüpfungspunkte stimmen in jeder Tiefe, und eine glatte Korrektur kann nicht allen folgen</translation>
    </message>
    <message>
      <source>{} tie points around ({}, {}) px (col, row) of the target agree among themselves and lie ({}, {}) px off what all others predict: rejected as wrong matches; if the ground has moved there, or is at another depth, they are right, and the correction does not hold there</source>
      <translation>{} Verknüpfungspunkte um ({}, {}) px (Spalte, Zeile) des Ziels stimmen untereinander überein und liegen ({}, {}) px neben dem, was alle anderen vorhersagen: als falsche Treffer verworfen; hat sich das Gelände dort bewegt, oder liegt es in anderer Tiefe, so stimmen sie, und die Korrektur gilt dort nicht</translation>
    </message>
    <message>
      <source>{} points that the matching had kept are left out of {}: residuals of the fit are those of chosen points; the check points are still all that were held out before</source>
      <translation>{} Punkte, die der Vergleich behalten hatte, fehlen in {}: Restfehler der Anpassung sind die ausgewählter Punkte; Kontrollpunkte sind noch alle, die zurückgehalten wurden</translation>
    </message>
    <message>
      <source>rows or columns are displaced against each other by {} px (RMS) within a matching window, and a tie point is the mean over it: the raster was resampled by nearest neighbour, or its scanner shook (jitter: try a smaller --window with --model jitter)</source>
      <translation>Zeilen oder Spalten sind innerhalb eines Vergleichsfensters um {} px (RMS) gegeneinander verschoben, und ein Verknüpfungspunkt ist das Mittel darüber: das Raster wurde nach nächstem Nachbarn umgerechnet, oder sein Scanner zitterte (Jitter: versuchen Sie ein kleineres --window mit --model jitter)</translation>
    </message>
    <message>
      <source>rising and falling edges lie ({}, {}) px (col, row) apart, as where one image shows heights, or other shadows: the tie points are means of the two, and share an error of half of that, which no residual shows and their sigmas hold</source>
      <translation>steigende und fallende Kanten liegen ({}, {}) px (Spalte, Zeile) auseinander, wie wo ein Bild Höhen zeigt, oder andere Schatten: die Verknüpfungspunkte sind Mittel von beiden und teilen einen Fehler von der Hälfte davon, den kein Restfehler zeigt und ihre Sigmas enthalten</translation>
    </message>
    <message>
      <source>grey values lie ({}, {}) px (col, row) beside what the edges tell, as in other light: the tie points share an error of up to that, which no residual shows and their sigmas hold</source>
      <translation>die Grauwerte liegen ({}, {}) px (Spalte, Zeile) neben dem, was die Kanten sagen, wie in anderem Licht: die Verknüpfungspunkte teilen einen Fehler bis zu diesem, den kein Restfehler zeigt und ihre Sigmas enthalten</translation>
    </message>
    <message>
      <source>what stands still in both frames agrees at no displacement; the ground was found about ({}, {}) px off, and is matched there</source>
      <translation>was in beiden Bildern stillsteht, stimmt ohne Verschiebung überein; das Gelände wurde etwa ({}, {}) px daneben gefunden und dort verglichen</translation>
    </message>
    <message>
      <source>its sigmas are not calibrated</source>
      <translation>ihre Sigmas sind nicht kalibriert</translation>
    </message>
    <message>
      <source>is a drawn map: its lines lie where they can be read, up to some metres beside the ground, and names and symbols show nothing of it; an image is better</source>
      <translation>ist eine gezeichnete Karte: ihre Linien liegen, wo sie lesbar sind, bis zu einige Meter neben dem Gelände, und Namen und Zeichen zeigen nichts von ihm; ein Bild ist besser</translation>
    </message>
    <message>
      <source>is georeferenced by ground control points: displacements count from the geotransform that fits them best, which is off by up to {} px; if that is much, raise --search-radius</source>
      <translation>ist durch Passpunkte georeferenziert: Verschiebungen zählen von der am besten passenden Geotransformation, die bis zu {} px daneben liegt; ist das viel, erhöhen Sie --search-radius</translation>
    </message>
    <message>
      <source>reference and target are the same file and band: the displacement is zero by construction</source>
      <translation>Referenz und Ziel sind dieselbe Datei und derselbe Kanal: die Verschiebung ist von vornherein null</translation>
    </message>
    <message>
      <source>reference and target are of the same product {}: the correction is applied to all its bands but the reference; it holds for those that lie as the target does</source>
      <translation>Referenz und Ziel sind aus demselben Produkt {}: die Korrektur gilt allen seinen Kanälen außer der Referenz; sie stimmt für die, die wie das Ziel liegen</translation>
    </message>
    <message>
      <source>a border of a scanned frame (tone about</source>
      <translation>ein Rand eines gescannten Bildes (Ton etwa</translation>
    </message>
    <message>
      <source>a constant border (value</source>
      <translation>ein konstanter Rand (Wert</translation>
    </message>
    <message>
      <source>of {} % of {} is taken for nodata; if it is data, declare another nodata value, or give a mask</source>
      <translation>von {} % von {} gilt als Nodata; sind es Daten, so geben Sie einen anderen Nodata-Wert an, oder eine Maske</translation>
    </message>
    <message>
      <source>values that nothing measures, such as {}, are taken for nodata ({} % of {}); declare them so (gdal_edit.py -a_nodata), or give a mask</source>
      <translation>Werte, die nichts misst, wie {}, gelten als Nodata ({} % von {}); geben Sie sie so an (gdal_edit.py -a_nodata), oder eine Maske</translation>
    </message>
    <message>
      <source>the DEM {} covers {} of {}: the rest is neither matched nor warped, as its heights are not known; the image lies at {}: give a DEM of all of it</source>
      <translation>das DGM {} bedeckt {} von {}: der Rest wird weder verglichen noch entzerrt, da seine Höhen unbekannt sind; das Bild liegt bei {}: geben Sie ein DGM des ganzen</translation>
    </message>
    <message>
      <source>Folder of an earlier registration</source>
      <translation>Ordner einer früheren Registrierung</translation>
    </message>
    <message>
      <source>Align this layer</source>
      <translation>Diesen Layer ausrichten</translation>
    </message>
    <message>
      <source>Place</source>
      <translation>Platzieren</translation>
    </message>
    <message>
      <source>More layers to align</source>
      <translation>Weitere Layer ausrichten</translation>
    </message>
    <message>
      <source>Other bands of the layer</source>
      <translation>Andere Kanäle des Layers</translation>
    </message>
    <message>
      <source>Vector layers drawn on it</source>
      <translation>Darauf gezeichnete Vektorlayer</translation>
    </message>
    <message>
      <source>Beside the layer</source>
      <translation>Neben dem Layer</translation>
    </message>
    <message>
      <source>Choose the layer and another one as its reference on the page “Align” first.</source>
      <translation>Wählen Sie zuerst den Layer und einen anderen als Referenz auf der Seite „Ausrichten“.</translation>
    </message>
    <message>
      <source>Tie points (*.points *.csv *.pts *.txt *.xml)</source>
      <translation>Verknüpfungspunkte (*.points *.csv *.pts *.txt *.xml)</translation>
    </message>
    <message>
      <source>Wheel of pcwlad-geo</source>
      <translation>Wheel von pcwlad-geo</translation>
    </message>
    <message>
      <source>The engine is installed: pcwlad-geo {}</source>
      <translation>Die Engine ist installiert: pcwlad-geo {}</translation>
    </message>
    <message>
      <source>Source folder of pcwlad-geo</source>
      <translation>Quellordner von pcwlad-geo</translation>
    </message>
    <message>
      <source>Cancelled; nothing was written.</source>
      <translation>Abgebrochen; nichts wurde geschrieben.</translation>
    </message>
    <message>
      <source>{} aligned</source>
      <translation>{} ausgerichtet</translation>
    </message>
    <message>
      <source>{} is corrected.</source>
      <translation>{} ist korrigiert.</translation>
    </message>
    <message>
      <source>Correct as “{}”:</source>
      <translation>Korrigieren wie „{}“:</translation>
    </message>
    <message>
      <source>{} is not where it was, or cannot be read.</source>
      <translation>{} liegt nicht mehr dort oder ist nicht lesbar.</translation>
    </message>
    <message>
      <source>Refined by matching.</source>
      <translation>Durch Matching verfeinert.</translation>
    </message>
    <message>
      <source>The engine refines the points…</source>
      <translation>Die Engine verfeinert die Punkte…</translation>
    </message>
    <message>
      <source>Click the same place on both maps: in the reference (large), in the target (small).</source>
      <translation>Klicken Sie dieselbe Stelle in beiden Karten an: in der Referenz (groß) und im Ziel (klein).</translation>
    </message>
    <message>
      <source>Click where the point should be, on either map.</source>
      <translation>Klicken Sie dorthin, wo der Punkt sein soll, in einer der beiden Karten.</translation>
    </message>
    <message>
      <source>The engine refines the point…</source>
      <translation>Die Engine verfeinert den Punkt…</translation>
    </message>
    <message>
      <source>Switch on</source>
      <translation>Einschalten</translation>
    </message>
    <message>
      <source>Switch off</source>
      <translation>Ausschalten</translation>
    </message>
    <message>
      <source>Delete</source>
      <translation>Löschen</translation>
    </message>
    <message>
      <source>Undo</source>
      <translation>Rückgängig</translation>
    </message>
    <message>
      <source>Redo</source>
      <translation>Wiederholen</translation>
    </message>
    <message>
      <source>{}: RMSE {:.3f} px at {} check points; {} points are on</source>
      <translation>{}: RMSE {:.3f} px an {} Kontrollpunkten; {} Punkte sind an</translation>
    </message>
    <message>
      <source>Select one point in the table first.</source>
      <translation>Wählen Sie zuerst einen Punkt in der Tabelle.</translation>
    </message>
    <message>
      <source>Now click the same place on the other map.</source>
      <translation>Jetzt dieselbe Stelle auf der anderen Karte anklicken.</translation>
    </message>
    <message>
      <source>{}: RMSE {:.3f} px</source>
      <translation>{}: RMSE {:.3f} px</translation>
    </message>
    <message>
      <source>Save points</source>
      <translation>Punkte speichern</translation>
    </message>
    <message>
      <source>Saved: {}</source>
      <translation>Gespeichert: {}</translation>
    </message>
    <message>
      <source>Update engine</source>
      <translation>Engine aktualisieren</translation>
    </message>
    <message>
      <source>Too few tie points place the layer.</source>
      <translation>Zu wenige Verknüpfungspunkte geben dem Layer einen Ort.</translation>
    </message>
    <message>
      <source>Choose the layer on the page “Align” first.</source>
      <translation>Wählen Sie zuerst den Layer auf der Seite „Ausrichten“.</translation>
    </message>
    <message>
      <source>These places are on one line. Click others.</source>
      <translation>Diese Stellen liegen auf einer Linie. Klicken Sie andere an.</translation>
    </message>
    <message>
      <source>Put &lt;b&gt;{}&lt;/b&gt; where it belongs on &lt;b&gt;{}&lt;/b&gt;.</source>
      <translation>Legen Sie &lt;b&gt;{}&lt;/b&gt; dorthin, wo es auf &lt;b&gt;{}&lt;/b&gt; gehört.</translation>
    </message>
    <message>
      <source>{} placed</source>
      <translation>{} platziert</translation>
    </message>
    <message>
      <source>on</source>
      <translation>an</translation>
    </message>
    <message>
      <source>off</source>
      <translation>aus</translation>
    </message>
    <message>
      <source>{} of {}</source>
      <translation>{} von {}</translation>
    </message>
    <message>
      <source>The engine did not finish.</source>
      <translation>Die Engine kam nicht zum Ende.</translation>
    </message>
    <message>
      <source>Align</source>
      <translation>Ausrichten</translation>
    </message>
    <message>
      <source>Layer (moves)</source>
      <translation>Layer (wird bewegt)</translation>
    </message>
    <message>
      <source>Advanced</source>
      <translation>Erweitert</translation>
    </message>
    <message>
      <source>Folder</source>
      <translation>Ordner</translation>
    </message>
    <message>
      <source>Where the results go: a new folder beside the layer unless you choose one.</source>
      <translation>Wohin die Ergebnisse kommen: ein neuer Ordner neben dem Layer, wenn Sie keinen wählen.</translation>
    </message>
    <message>
      <source>Moves the layer onto the reference; the layer itself stays as it is.</source>
      <translation>Bringt den Layer auf die Referenz; der Layer selbst bleibt, wie er ist.</translation>
    </message>
    <message>
      <source>Open…</source>
      <translation>Öffnen…</translation>
    </message>
    <message>
      <source>Opens an earlier registration: its folder.</source>
      <translation>Öffnet eine frühere Registrierung: ihren Ordner.</translation>
    </message>
    <message>
      <source>Help</source>
      <translation>Hilfe</translation>
    </message>
    <message>
      <source>Opens the help in the browser; it comes with the plugin.</source>
      <translation>Öffnet die Hilfe im Browser; sie liegt dem Plugin bei.</translation>
    </message>
    <message>
      <source>Correct them too</source>
      <translation>Auch diese korrigieren</translation>
    </message>
    <message>
      <source>Applies the correction to other bands of the layer; nothing is matched.</source>
      <translation>Wendet die Korrektur auf andere Kanäle des Layers an; nichts wird verglichen.</translation>
    </message>
    <message>
      <source>The tie points of a result are edited here. Align a layer first, or open points or a result.</source>
      <translation>Hier werden die Verknüpfungspunkte eines Ergebnisses bearbeitet. Richten Sie zuerst einen Layer aus, oder öffnen Sie Punkte oder ein Ergebnis.</translation>
    </message>
    <message>
      <source>Open points of a file…</source>
      <translation>Punkte einer Datei öffnen…</translation>
    </message>
    <message>
      <source>Fits the points of a file, such as those of the Georeferencer (.points), to the layers of the page “Align”, and opens them here.</source>
      <translation>Passt die Punkte einer Datei, etwa die der Georeferenzierung (.points), an die Layer der Seite „Ausrichten“ an und öffnet sie hier.</translation>
    </message>
    <message>
      <source>Open an earlier registration…</source>
      <translation>Frühere Registrierung öffnen…</translation>
    </message>
    <message>
      <source>Once a layer is aligned: does it fit? See the result on the map beside, in turns with, or over the layer as it was or the reference.</source>
      <translation>Sobald ein Layer ausgerichtet ist: passt er? Das Ergebnis auf der Karte ansehen: neben, im Wechsel mit oder über dem Layer, wie er war, oder der Referenz.</translation>
    </message>
    <message>
      <source>The layer as it was, or the reference, left of the mouse; the map right of it.</source>
      <translation>Links der Maus der Layer, wie er war, oder die Referenz, rechts die Karte.</translation>
    </message>
    <message>
      <source>Swipe</source>
      <translation>Wischen</translation>
    </message>
    <message>
      <source>Swipe, blink and transparency compare the result with the reference, not with the layer as it was.</source>
      <translation>Wischen, Blinken und Transparenz vergleichen das Ergebnis mit der Referenz, nicht mit dem Layer, wie er war.</translation>
    </message>
    <message>
      <source>Compare with the reference</source>
      <translation>Mit der Referenz vergleichen</translation>
    </message>
    <message>
      <source>Shows the result and the layer as it was, or the reference, in turns.</source>
      <translation>Zeigt abwechselnd das Ergebnis und den Layer, wie er war, oder die Referenz.</translation>
    </message>
    <message>
      <source>Blink</source>
      <translation>Blinken</translation>
    </message>
    <message>
      <source>Transparency</source>
      <translation>Transparenz</translation>
    </message>
    <message>
      <source>The result, so transparent, over the layer as it was or the reference.</source>
      <translation>Das Ergebnis, so durchsichtig, über dem Layer, wie er war, oder der Referenz.</translation>
    </message>
    <message>
      <source>The reference in red and the result in cyan: grey where they agree.</source>
      <translation>Die Referenz in Rot und das Ergebnis in Cyan: grau, wo sie übereinstimmen.</translation>
    </message>
    <message>
      <source>The edges of the reference, in red over the result.</source>
      <translation>Die Kanten der Referenz, in Rot über dem Ergebnis.</translation>
    </message>
    <message>
      <source>Edges</source>
      <translation>Kanten</translation>
    </message>
    <message>
      <source>A map of what is left at the tie points, in target pixels.</source>
      <translation>Eine Karte dessen, was an den Verknüpfungspunkten übrig ist, in Zielpixeln.</translation>
    </message>
    <message>
      <source>Hold Space on the map to see the reference alone.</source>
      <translation>Halten Sie auf der Karte die Leertaste, um die Referenz allein zu sehen.</translation>
    </message>
    <message>
      <source>The correction that is fitted; the RMSE is that at the check points, which no fit uses.</source>
      <translation>Die Korrektur, die angepasst wird; der RMSE gilt für die Kontrollpunkte, die keine Anpassung nutzt.</translation>
    </message>
    <message>
      <source>Takes the last change back (Ctrl+Z).</source>
      <translation>Nimmt die letzte Änderung zurück (Strg+Z).</translation>
    </message>
    <message>
      <source>Makes it again (Ctrl+Shift+Z).</source>
      <translation>Macht sie noch einmal (Strg+Umschalt+Z).</translation>
    </message>
    <message>
      <source>Click a point on either map: its row is selected.</source>
      <translation>Klicken Sie einen Punkt auf einer der beiden Karten an: Seine Zeile wird ausgewählt.</translation>
    </message>
    <message>
      <source>Pick</source>
      <translation>Wählen</translation>
    </message>
    <message>
      <source>Click the same place on both maps, in either order. Esc leaves.</source>
      <translation>Dieselbe Stelle auf beiden Karten anklicken, in beliebiger Reihenfolge. Esc beendet.</translation>
    </message>
    <message>
      <source>Add</source>
      <translation>Hinzufügen</translation>
    </message>
    <message>
      <source>Click where the selected point should be, on either map. Esc leaves.</source>
      <translation>Auf einer der Karten dorthin klicken, wo der gewählte Punkt sein soll. Esc beendet.</translation>
    </message>
    <message>
      <source>Move</source>
      <translation>Verschieben</translation>
    </message>
    <message>
      <source>Takes the selected points away (Del).</source>
      <translation>Entfernt die gewählten Punkte (Entf).</translation>
    </message>
    <message>
      <source>Refines all points that are on by matching, within the radius, and selects those that the others contradict.</source>
      <translation>Verfeinert alle eingeschalteten Punkte durch Matching innerhalb des Radius und wählt die aus, denen die anderen widersprechen.</translation>
    </message>
    <message>
      <source>Improve</source>
      <translation>Verbessern</translation>
    </message>
    <message>
      <source>Matching refines a point within this radius, the circle on both maps.</source>
      <translation>In diesem Umkreis, dem Kreis auf beiden Karten, wird ein Punkt durch Vergleich verfeinert.</translation>
    </message>
    <message>
      <source>Refined within </source>
      <translation>Verfeinert in </translation>
    </message>
    <message>
      <source> px</source>
      <translation> px</translation>
    </message>
    <message>
      <source>How much longer than they are the residuals are drawn.</source>
      <translation>Um wie viel länger, als sie sind, die Restfehler gezeichnet werden.</translation>
    </message>
    <message>
      <source>Arrows: automatic</source>
      <translation>Pfeile: automatisch</translation>
    </message>
    <message>
      <source>Arrows × </source>
      <translation>Pfeile × </translation>
    </message>
    <message>
      <source>Switches off all points in a rectangle that you draw on the large map.</source>
      <translation>Schaltet alle Punkte in einem Rechteck aus, das Sie auf der großen Karte ziehen.</translation>
    </message>
    <message>
      <source>Off: rectangle</source>
      <translation>Aus: Rechteck</translation>
    </message>
    <message>
      <source>Switches off all points whose residual is longer than this.</source>
      <translation>Schaltet alle Punkte aus, deren Restfehler länger ist.</translation>
    </message>
    <message>
      <source>Off: longer than</source>
      <translation>Aus: länger als</translation>
    </message>
    <message>
      <source>Shows the layer over the map, where the fit puts it: it moves with each change.</source>
      <translation>Zeigt den Layer über der Karte, wo die Anpassung ihn hinlegt: Er wandert mit jeder Änderung.</translation>
    </message>
    <message>
      <source>Over the map</source>
      <translation>Über der Karte</translation>
    </message>
    <message>
      <source>Writes a file of the Georeferencer.</source>
      <translation>Schreibt eine Datei des Georeferenzierers.</translation>
    </message>
    <message>
      <source>Save points…</source>
      <translation>Punkte speichern…</translation>
    </message>
    <message>
      <source>Registers the pair again with these points and this model.</source>
      <translation>Registriert das Paar neu mit diesen Punkten und diesem Modell.</translation>
    </message>
    <message>
      <source>Align with these</source>
      <translation>Mit diesen ausrichten</translation>
    </message>
    <message>
      <source>The engine is starting…</source>
      <translation>Die Engine startet…</translation>
    </message>
    <message>
      <source>Cancel</source>
      <translation>Abbrechen</translation>
    </message>
    <message>
      <source>Ends the work; nothing is left of it.</source>
      <translation>Beendet die Arbeit; nichts bleibt davon zurück.</translation>
    </message>
    <message>
      <source>Trust these files, and go on</source>
      <translation>Diesen Dateien vertrauen und fortfahren</translation>
    </message>
    <message>
      <source>The engine may read whatever these files name, wherever it is. Asked once for each file.</source>
      <translation>Die Engine darf lesen, was diese Dateien nennen, wo immer es liegt. Wird je Datei einmal gefragt.</translation>
    </message>
    <message>
      <source>Place by hand…</source>
      <translation>Von Hand platzieren…</translation>
    </message>
    <message>
      <source>Put the layer where it belongs with the mouse; it is registered from there.</source>
      <translation>Den Layer mit der Maus dorthin schieben, wo er hingehört; von dort wird er registriert.</translation>
    </message>
    <message>
      <source>Use points of a file…</source>
      <translation>Punkte einer Datei verwenden…</translation>
    </message>
    <message>
      <source>Aligns the layer by points that you have placed: of the Georeferencer (.points), tiepoints.csv, ENVI. Nothing is matched.</source>
      <translation>Richtet den Layer nach Punkten aus, die Sie gesetzt haben: des Georeferenzierers (.points), tiepoints.csv, ENVI. Es wird nichts zugeordnet.</translation>
    </message>
    <message>
      <source>Downloads the engine from the package index, about 280 MB, into an environment of its own: 1 GB on the disk, some minutes.</source>
      <translation>Lädt die Engine aus dem Paketverzeichnis, etwa 280 MB, in eine eigene Umgebung: 1 GB auf der Platte, einige Minuten.</translation>
    </message>
    <message>
      <source>From a wheel…</source>
      <translation>Aus einem Wheel…</translation>
    </message>
    <message>
      <source>Installs the engine from its file pcwlad_geo-….whl; the libraries that it needs are downloaded.</source>
      <translation>Installiert die Engine aus ihrer Datei pcwlad_geo-….whl; die nötigen Bibliotheken werden geladen.</translation>
    </message>
    <message>
      <source>From a folder…</source>
      <translation>Aus einem Ordner…</translation>
    </message>
    <message>
      <source>Installs the engine from its source folder, the one with pyproject.toml.</source>
      <translation>Installiert die Engine aus ihrem Quellordner, dem mit pyproject.toml.</translation>
    </message>
    <message>
      <source>By the mouse</source>
      <translation>Mit der Maus</translation>
    </message>
    <message>
      <source>Drag moves the layer, Ctrl-drag turns it, Alt-wheel scales it, arrow keys step.</source>
      <translation>Ziehen verschiebt den Layer, Strg+Ziehen dreht, Alt+Mausrad skaliert, Pfeiltasten gehen schrittweise.</translation>
    </message>
    <message>
      <source>By pairs of places</source>
      <translation>Mit Stellenpaaren</translation>
    </message>
    <message>
      <source>Two or three clicked pairs of places put the layer.</source>
      <translation>Zwei oder drei angeklickte Paare von Stellen platzieren den Layer.</translation>
    </message>
    <message>
      <source>dx (map units)</source>
      <translation>dx (Karteneinheiten)</translation>
    </message>
    <message>
      <source>dy (map units)</source>
      <translation>dy (Karteneinheiten)</translation>
    </message>
    <message>
      <source>Angle (° to the left)</source>
      <translation>Winkel (° nach links)</translation>
    </message>
    <message>
      <source>Scale</source>
      <translation>Maßstab</translation>
    </message>
    <message>
      <source>Opacity</source>
      <translation>Deckkraft</translation>
    </message>
    <message>
      <source>Takes back the last step: Ctrl-Z.</source>
      <translation>Macht den letzten Schritt rückgängig: Strg+Z.</translation>
    </message>
    <message>
      <source>Does again what was taken back.</source>
      <translation>Stellt wieder her, was rückgängig gemacht wurde.</translation>
    </message>
    <message>
      <source>Into view</source>
      <translation>Ins Bild</translation>
    </message>
    <message>
      <source>Puts the layer upright into the middle of the map.</source>
      <translation>Legt den Layer aufrecht in die Mitte der Karte.</translation>
    </message>
    <message>
      <source>Snap</source>
      <translation>Einrasten</translation>
    </message>
    <message>
      <source>Aligns the layer with the reference, from where it is put by hand.</source>
      <translation>Richtet den Layer an der Referenz aus, ausgehend von seiner Lage von Hand.</translation>
    </message>
    <message>
      <source>Save as placed</source>
      <translation>Platziert speichern</translation>
    </message>
    <message>
      <source>Writes &lt;layer&gt;_placed.vrt: the same pixels, where they are put.</source>
      <translation>Schreibt &lt;Layer&gt;_placed.vrt: dieselben Pixel, an der gelegten Stelle.</translation>
    </message>
  </context>
</TS>
